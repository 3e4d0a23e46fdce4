// Goal: the mosaic is what the project promises: whole, in its place, undistorted and sharper than any single frame; and real recordings
// end in a mosaic too. Method: simulated sorties with known truth and telemetry errors, `trem run` with real processes, trem_score
// against the truth; real recordings where the shared sample data are present.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <sstream>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::uint64_t kWorkerBytesMax = 1ULL << 30;

struct Scenario {
  std::string name;
  std::vector<std::string> simulation;
  std::vector<std::string> run;  // "=@/" names a path within the simulation.
  double distortion_p95_px_max = 0.5;
  std::vector<std::string> frames = {"--width", "160", "--height", "120", "--frames", "60"};
  double gain_db_min = 3.0;
};

// Without it a failing test, and ctest's list, would show the bytes of the struct.
void PrintTo(const Scenario& scenario, std::ostream* out) { *out << scenario.name; }

class SimulatedSortie : public ::testing::TestWithParam<Scenario> {};

// The bounds: coverage, gain over the bicubic frame placed with its true pose, distortion after one global shift, and absolute
// position within the simulated receiver's bias. What the alignment loses is held against the same scenes placed with the true transforms.
TEST_P(SimulatedSortie, GivesAMosaicThatIsWholeInPlaceAndSharper) {
  const RunFixture fixture;
  const fs::path sortie = fixture.folder() / "sortie";
  std::vector<std::string> simulate = {BinaryPath("trem").string(), "simulate", "-o", sortie.string(), "--quiet"};
  simulate.insert(simulate.end(), GetParam().frames.begin(), GetParam().frames.end());
  simulate.insert(simulate.end(), GetParam().simulation.begin(), GetParam().simulation.end());
  ASSERT_EQ(fixture.Run(simulate).exit_code, 0);

  const fs::path mosaic = fixture.folder() / "mosaic.tif";
  std::vector<std::string> argv = {BinaryPath("trem").string(),
                                   "run",
                                   (sortie / "sortie.textproto").string(),
                                   "-o",
                                   mosaic.string(),
                                   "--quiet",
                                   "--workers",
                                   "2",
                                   "--keep-work"};
  for (std::string option : GetParam().run) {
    if (const std::size_t at = option.find("=@/"); at != std::string::npos) option.replace(at + 1, 1, sortie.string());
    argv.push_back(option);
  }
  const Completed run = fixture.Run(argv);
  ASSERT_EQ(run.exit_code, 0) << run.stderr_text;
  EXPECT_THAT(run.orphans, IsEmpty());

  const Completed score = fixture.Run({BinaryPath("trem_score").string(), "--simulation", sortie.string(), "--mosaic", mosaic.string(),
                                       "--work", mosaic.string() + ".work", "--json"});
  ASSERT_EQ(score.exit_code, 0) << score.stderr_text;
  const nlohmann::json figures = nlohmann::json::parse(score.stdout_text);
  EXPECT_GE(figures.at("coverage").get<double>(), 0.97) << score.stdout_text;
  EXPECT_GE(figures.at("gain_db").get<double>(), GetParam().gain_db_min) << score.stdout_text;
  EXPECT_LE(figures.at("distortion_p95_px").get<double>(), GetParam().distortion_p95_px_max) << score.stdout_text;
  EXPECT_LE(figures.at("absolute_error_m").get<double>(), figures.at("gps_bias_m").get<double>() + 0.3) << score.stdout_text;
  EXPECT_LE(figures.at("placement_loss_db").get<double>(), 0.7) << score.stdout_text;
}

INSTANTIATE_TEST_SUITE_P(
    Flights, SimulatedSortie,
    ::testing::Values(
        Scenario{"Nadir", {}, {}}, Scenario{"Oblique", {"--pitch-deg", "-45"}, {}},
        Scenario{"WideProjective", {"--pitch-deg", "-45", "--hfov-deg", "20"}, {"--set", "tre.view_model=PROJECTIVE"}},
        // A tenth of the camera's height.
        Scenario{"Hills", {"--hfov-deg", "30", "--relief-m", "9"}, {"--set", "telemetry.dem_path=@/truth/dem.tif"}, 1.0},
        Scenario{"Movers", {"--movers", "8", "--drop", "0.03"}, {}}, Scenario{"SixteenBit", {"--bits", "16", "--seed", "2"}, {}},
        Scenario{"RatioTwo", {}, {"--set", "tre.ratio=2"}},
        // Two thirds of a photograph are on the next one, nothing of a ROI: each scene is of one frame, hardly sharper than it.
        Scenario{"Photographs",
                 {"--hfov-deg", "30", "--speed-px", "110", "--rate-hz", "0.2", "--terrain-width", "3000"},
                 {},
                 0.5,
                 {"--width", "320", "--height", "240", "--frames", "6"},
                 1.5},
        Scenario{"HintsThenGaussNewton", {}, {"--set", "tre.registration=HINTS_THEN_GAUSS_NEWTON"}}),
    [](const auto& instance) { return instance.param.name; });

// Frame index -> whether some window registered the frame or started a scene with it. The columns before the status hold no commas here.
std::map<std::string, bool> FramesInTheChain(const fs::path& chain_csv) {
  std::map<std::string, bool> frames;
  std::vector<std::string> lines = Lines(FileContents(chain_csv));
  EXPECT_GT(lines.size(), 1U) << chain_csv;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    std::istringstream line(lines[i]);
    std::vector<std::string> fields;
    for (std::string field; fields.size() < 6 && std::getline(line, field, ',');) fields.push_back(field);
    if (fields.size() < 6) {
      ADD_FAILURE() << "short line " << lines[i];
      continue;
    }
    frames[fields[0]] |= fields[5] == "registered" || fields[5] == "started_scene";
  }
  return frames;
}

class RealRecording : public ::testing::TestWithParam<std::string> {};

TEST_P(RealRecording, EndsInAMosaicInLocalCoordinates) {
  const std::optional<fs::path> data = TestDataDir();
  if (!data) GTEST_SKIP() << "the shared sample data are not on this machine (TREM_TEST_DATA names their folder)";
  const RunFixture fixture;
  const fs::path out = fixture.NewFolder("out");
  const Completed run = fixture.Run({BinaryPath("trem").string(), "run", (*data / GetParam()).string(), "-o", (out / "mosaic.tif").string(),
                                     "--json", "--quiet", "--workers", "2"});
  ASSERT_EQ(run.exit_code, 0) << run.stderr_text;
  const nlohmann::json report = nlohmann::json::parse(run.stdout_text);
  EXPECT_LT(report.at("peak_memory_bytes").get<std::uint64_t>(), kWorkerBytesMax);
  for (const char* name : {"mosaic.tif", "mosaic_quality.tif", "mosaic_chain.csv", "mosaic_windows.geojson", "mosaic_preview.png"}) {
    EXPECT_TRUE(fs::exists(out / name)) << name;
  }
  // Every frame of these recordings shows the same ground, so every one is in the chain of some window.
  for (const auto& [frame, registered] : FramesInTheChain(out / "mosaic_chain.csv")) EXPECT_TRUE(registered) << "frame " << frame;
  EXPECT_THAT(FileContents(out / "mosaic_report.html"), HasSubstr("local"));
}

INSTANTIATE_TEST_SUITE_P(Sets, RealRecording, ::testing::Values("fmv/aphill_240_1fps_crf32.mp4", "hit_uav_run"), [](const auto& instance) {
  std::string name = fs::path(instance.param).stem().string();
  std::erase(name, '_');
  return name;
});

}  // namespace
}  // namespace trem::testing
