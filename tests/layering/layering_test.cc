// Goal: the folders depend on each other as docs/ARCHITECTURE.md says, and nothing else.
// Method: read every #include of the source tree and hold it against the include table; then plant violations in a temporary tree and see
// that each is named with its file and line, so that a green first test means something.

#include "tests/layering/layering_rules.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace trem::layering {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(LayeringTest, EveryIncludeObeysTheTable) {
  ASSERT_TRUE(fs::exists(fs::path(TREM_SOURCE_DIR) / "mosaic/base/status.h")) << TREM_SOURCE_DIR;
  EXPECT_THAT(ToString(CheckTree(TREM_SOURCE_DIR)), IsEmpty());
}

TEST(LayeringTest, NamesFileAndLineOfAPlantedViolationInATree) {
  const fs::path root = fs::path(testing::TempDir()) / "layering_planted";
  fs::remove_all(root);
  fs::create_directories(root / "mosaic/geometry");
  fs::create_directories(root / "coordinator/app");
  std::ofstream(root / "mosaic/geometry/roi.h") << "#pragma once\n\n#include \"mosaic/base/check.h\"\n#include \"worker/tre/engine.h\"\n";
  std::ofstream(root / "coordinator/app/main.cc") << "#include <opencv2/core.hpp>\n";
  const std::string report = ToString(CheckTree(root));
  fs::remove_all(root);
  EXPECT_THAT(report, HasSubstr("mosaic/geometry/roi.h:4: includes \"worker/tre/engine.h\""));
  EXPECT_THAT(report, HasSubstr("coordinator/app/main.cc:1: includes <opencv2/core.hpp>"));
  EXPECT_EQ(std::count(report.begin(), report.end(), '\n'), 2) << report;
}

struct Planted {
  const char* file;
  const char* text;
};

class ForbiddenIncludeTest : public testing::TestWithParam<Planted> {};

TEST_P(ForbiddenIncludeTest, IsReportedOnce) {
  EXPECT_EQ(CheckFile(GetParam().file, GetParam().text).size(), 1U) << GetParam().file << ": " << GetParam().text;
}

INSTANTIATE_TEST_SUITE_P(Planted, ForbiddenIncludeTest,
                         testing::Values(Planted{"mosaic/base/status.h", "#include \"mosaic/geometry/roi.h\""},
                                         Planted{"mosaic/raster/cog.cc", "#include \"proto/trem/v1/task.pb.h\""},
                                         Planted{"mosaic/geometry/roi.h", "#include <opencv2/core.hpp>"},
                                         Planted{"proto/codec/convert.cc", "#  include <gdal_priv.h>"},
                                         Planted{"proto/trem/v1/job.proto", "import \"proto/codec/other.proto\";"},
                                         Planted{"worker/registration/hints.h", "#include \"worker/tre/engine.h\""},
                                         Planted{"worker/sensor/psf.cc", "#include \"proto/trem/v1/job.pb.h\""},
                                         Planted{"worker/tasks/enhance_task.cc", "#include \"worker/app/enhance_command.h\""},
                                         Planted{"worker/app/main.cc", "#include \"coordinator/app/server.h\""},
                                         Planted{"coordinator/scheduling/scheduler.h", "#include \"coordinator/store/event_log.h\""},
                                         Planted{"coordinator/scheduling/scheduler.cc", "#include <chrono>"},
                                         Planted{"coordinator/planning/window_plan.cc", "#include \"mosaic/base/file.h\""},
                                         Planted{"coordinator/app/server.cc", "#include \"worker/tasks/task.h\""},
                                         Planted{"coordinator/app/server.cc", "#include \"mosaic/raster/cog.h\""},
                                         Planted{"coordinator/cli/run.cc", "#include <libavformat/avformat.h>"},
                                         Planted{"mosaic/raster/cog.cc", "#include \"../geometry/roi.h\""},
                                         Planted{"mosaic/unheard_of/x.cc", "#include <vector>"}));

TEST(LayeringTest, GrantsWhatTheTableGrants) {
  EXPECT_THAT(CheckFile("worker/tre/engine.cc",
                        "#include \"worker/tre/engine.h\"\n#include <vector>\n#include <opencv2/core.hpp>\n"
                        "#include \"worker/registration/hints.h\"\n#include \"mosaic/base/status.h\"\n"),
              IsEmpty());
}

TEST(LayeringTest, ReportsAFileThatIsTooLong) {
  std::string text;
  for (int i = 0; i < kLineCountMax; ++i) text += "\n";
  EXPECT_THAT(CheckFile("mosaic/base/a.h", text), IsEmpty());
  const std::vector<Violation> violations = CheckFile("mosaic/base/a.h", text + "\n");
  ASSERT_EQ(violations.size(), 1U);
  EXPECT_EQ(violations[0].line, kLineCountMax + 1);
}

}  // namespace
}  // namespace trem::layering
