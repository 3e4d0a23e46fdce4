// Goal: every kind of bad input ends with its documented exit code and one message that names the thing, without a process left or a file
// half written. Method: take a good simulated sortie, spoil one thing, run the real programs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;

constexpr int kFrameCount = 24;

class BadInputTest : public ::testing::Test {
 protected:
  // Expects `exit_code`, exactly one line on stderr, that it contains `named`, and that nothing is left.
  void ExpectRefused(const fs::path& source, const std::string& named, int exit_code = 3, const std::vector<std::string>& more = {}) {
    const fs::path out = fixture_.NewFolder("out");
    std::vector<std::string> options = {"--workers", "2", "--quiet"};
    options.insert(options.end(), more.begin(), more.end());
    const Completed run = fixture_.Run(RunFixture::RunArguments(source, out / "mosaic.tif", options));
    ExpectOneMessage(run, named, exit_code);
    EXPECT_THAT(NamesIn(out), IsEmpty());
  }

  void ExpectOneMessage(const Completed& run, const std::string& named, int exit_code) {
    EXPECT_EQ(run.exit_code, exit_code);
    EXPECT_EQ(Lines(run.stderr_text).size(), 1u) << run.stderr_text;
    EXPECT_THAT(run.stderr_text, HasSubstr("trem: error: "));
    EXPECT_THAT(run.stderr_text, HasSubstr(named));
    EXPECT_THAT(run.orphans, IsEmpty());
    EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
  }

  // Rewrites telemetry.csv line by line; line 0 is the header.
  template <typename Edit>
  void EditTelemetry(const fs::path& sortie, const Edit& edit) {
    const fs::path path = RunFixture::FramesFolder(sortie) / "telemetry.csv";
    std::string text;
    const std::vector<std::string> lines = Lines(FileContents(path));
    for (std::size_t i = 0; i < lines.size(); ++i) text += edit(i, lines[i]) + "\n";
    WriteFileContents(path, text);
  }

  // Replaces one field of a CSV line.
  static std::string WithField(const std::string& line, std::size_t index, const std::string& value) {
    std::vector<std::string> fields;
    std::istringstream in(line);
    for (std::string field; std::getline(in, field, ',');) fields.push_back(field);
    fields.at(index) = value;
    std::string text;
    for (std::size_t i = 0; i < fields.size(); ++i) text += (i == 0 ? "" : ",") + fields[i];
    return text;
  }
  static std::size_t ColumnOf(const std::string& header, const std::string& name) {
    std::istringstream in(header);
    std::size_t index = 0;
    for (std::string field; std::getline(in, field, ','); ++index) {
      if (field == name) return index;
    }
    ADD_FAILURE() << "no column " << name << " in " << header;
    return 0;
  }

  // For faults that must be found before an image is opened.
  fs::path FolderWithAnImage() const {
    const fs::path frames = fixture_.NewFolder("frames");
    WriteFileContents(frames / "00000.png", "");
    return frames;
  }

  RunFixture fixture_;
};

TEST_F(BadInputTest, RefusesAPathThatDoesNotExist) { ExpectRefused(fixture_.folder() / "no-such-flight.ts", "no-such-flight.ts"); }

TEST_F(BadInputTest, RefusesAnEmptyFolder) { ExpectRefused(fixture_.NewFolder("nothing-in-here"), "nothing-in-here"); }

TEST_F(BadInputTest, RefusesAFolderWhoseOnlyImageIsText) {
  const fs::path frames = fixture_.NewFolder("frames");
  WriteFileContents(frames / "notes.png", "these are notes, not pixels\n");
  ExpectRefused(frames, "notes.png");
}

TEST_F(BadInputTest, WarnsOfATextFileAmongGoodFramesAndMakesTheMosaic) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", kFrameCount);
  const fs::path bad = RunFixture::Frames(sortie).at(10);
  WriteFileContents(bad, "these are notes, not pixels\n");
  const fs::path out = fixture_.NewFolder("out");
  const Completed run = fixture_.Run(RunFixture::RunArguments(sortie / "sortie.textproto", out / "mosaic.tif", {"--quiet"}));
  EXPECT_EQ(run.exit_code, 0) << run.stderr_text;
  EXPECT_THAT(run.stderr_text, HasSubstr("trem: warning: "));
  EXPECT_THAT(run.stderr_text, HasSubstr(bad.filename().string()));
  EXPECT_TRUE(fs::exists(out / "mosaic.tif"));
}

TEST_F(BadInputTest, WarnsOfFramesOfAnotherSizeAndMakesTheMosaic) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", kFrameCount);
  const fs::path other = fixture_.SimulateSortie("other", 3, {"--width", "96", "--height", "72"});
  const std::vector<fs::path> frames = RunFixture::Frames(sortie);
  fs::copy_file(RunFixture::Frames(other).at(0), frames.at(12), fs::copy_options::overwrite_existing);
  const fs::path out = fixture_.NewFolder("out");
  const Completed run = fixture_.Run(RunFixture::RunArguments(sortie / "sortie.textproto", out / "mosaic.tif", {"--quiet"}));
  EXPECT_EQ(run.exit_code, 0) << run.stderr_text;
  EXPECT_THAT(run.stderr_text, HasSubstr(frames.at(12).filename().string()));
  EXPECT_THAT(run.stderr_text, HasSubstr("96"));
  EXPECT_TRUE(fs::exists(out / "mosaic.tif"));
}

TEST_F(BadInputTest, RefusesAVideoThatBreaksOffBeforeItsIndex) {
  // An MP4 whose recording was cut off: file type and media data are there, the index (moov) at the end is not.
  std::string bytes(
      "\x00\x00\x00\x18"
      "ftypisom\x00\x00\x02\x00isomiso2",
      24);
  bytes += std::string(
               "\x00\x10\x00\x00"
               "mdat",
               8) +
           std::string(5000, '\x5a');
  const fs::path video = fixture_.folder() / "cut-off.mp4";
  WriteFileContents(video, bytes);
  ExpectRefused(video, "cut-off.mp4");
}

TEST_F(BadInputTest, MakesAMosaicOfWhatIsThereOfATransportStreamThatBreaksOff) {
  const auto data = TestDataDir();
  if (!data) GTEST_SKIP() << "shared sample data are not on this machine (set TREM_TEST_DATA): truncated real video is not tested";
  const std::string whole = FileContents(*data / "fmv" / "aphill_short.ts");
  const fs::path video = fixture_.folder() / "cut.ts";
  WriteFileContents(video, whole.substr(0, std::min<std::size_t>(whole.size() / 4, 1500000) + 77));
  const fs::path out = fixture_.NewFolder("out");
  const Completed run = fixture_.Run({BinaryPath("trem").string(), "run", video.string(), "-o", (out / "mosaic.tif").string(), "--quiet",
                                      "--set", "source.max_frames=12"});
  EXPECT_EQ(run.exit_code, 0) << run.stderr_text;
  EXPECT_TRUE(fs::exists(out / "mosaic.tif"));
  EXPECT_THAT(run.orphans, IsEmpty());
}

TEST_F(BadInputTest, RefusesTelemetryWithAWrongHeader) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", kFrameCount);
  EditTelemetry(sortie, [](std::size_t i, const std::string& line) {
    return i == 0 ? WithField(line, ColumnOf(line, "latitude_deg"), "lattitude") : line;
  });
  ExpectRefused(sortie / "sortie.textproto", "latitude_deg");
}

TEST_F(BadInputTest, RefusesTelemetryWhoseUnitsAreOutOfRange) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", kFrameCount);
  std::size_t column = 0;
  EditTelemetry(sortie, [&](std::size_t i, const std::string& line) {
    if (i == 0) column = ColumnOf(line, "latitude_deg");
    return i == 5 ? WithField(line, column, "5124.25") : line;
  });
  ExpectRefused(sortie / "sortie.textproto", "telemetry.csv:6");
}

TEST_F(BadInputTest, RefusesTelemetryThatMatchesNoFrame) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", kFrameCount);
  std::size_t column = 0;
  EditTelemetry(sortie, [&](std::size_t i, const std::string& line) {
    if (i == 0) column = ColumnOf(line, "frame");
    return i == 0 ? line : WithField(line, column, "other-flight-" + std::to_string(i) + ".png");
  });
  ExpectRefused(sortie / "sortie.textproto", "telemetry.csv");
}

TEST_F(BadInputTest, RefusesAMisspeltFieldWithLineColumnAndSuggestion) {
  const fs::path spec = fixture_.folder() / "sortie.textproto";
  WriteFileContents(spec, "source { path: \".\" }\ntre {\n  ratoi: 3\n}\n");
  ExpectRefused(spec, "sortie.textproto:3:3");
  const Completed again = fixture_.Run({BinaryPath("trem").string(), "run", spec.string(), "-o", (fixture_.folder() / "m.tif").string()});
  EXPECT_THAT(again.stderr_text, HasSubstr("did you mean 'ratio'"));
}

TEST_F(BadInputTest, RefusesAMisspeltOverride) { ExpectRefused(FolderWithAnImage(), "ratoi", 3, {"--set", "tre.ratoi=3"}); }

TEST_F(BadInputTest, RefusesAnOutputBelowARegularFile) {
  const fs::path frames = FolderWithAnImage();
  WriteFileContents(fixture_.folder() / "file", "");
  const fs::path output = fixture_.folder().path() / "file" / "mosaic.tif";
  ExpectOneMessage(fixture_.Run(RunFixture::RunArguments(frames, output, {"--quiet"})), output.parent_path().string(), 3);
}

TEST_F(BadInputTest, RefusesAnOutputWhereNoFileCanBeMade) {
  const fs::path frames = FolderWithAnImage();
  ExpectOneMessage(fixture_.Run(RunFixture::RunArguments(frames, "/proc/mosaic.tif", {"--quiet"})), "/proc", 3);
}

TEST_F(BadInputTest, RefusesAnOutputAmongTheFrames) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 3);
  const fs::path frames = RunFixture::FramesFolder(sortie);
  ExpectOneMessage(fixture_.Run(RunFixture::RunArguments(frames, frames / "mosaic.tif", {"--quiet"})), "would be taken for a frame", 3);
}

// Runs `script` under sh in a mount namespace of its own, so that mounts vanish with it.
class FullDiskTest : public BadInputTest {
 protected:
  void SetUp() override {
    for (const char* flags : {"-m", "-rm"}) {
      const Completed probe = fixture_.Run(
          {"sh", "-c", std::string("unshare ") + flags + " mount -t tmpfs -o size=64k none " + fixture_.folder().path().string()});
      if (probe.exit_code == 0) unshare_flags_ = flags;
      if (!unshare_flags_.empty()) return;
    }
    GTEST_SKIP() << "mounting a tmpfs is not permitted here: full and read-only disks are not tested";
  }

  // Mounts a tmpfs with `options` at `mount_point`, runs trem there, then prints the names left in it. "%" in stdout separates them.
  Completed RunOnTmpfs(const fs::path& mount_point, const std::string& before, const std::vector<std::string>& argv,
                       const std::string& options) {
    std::string command;
    for (const std::string& argument : argv) command += " '" + argument + "'";
    const std::string script = "mount -t tmpfs -o " + options + " none '" + mount_point.string() + "' && " + before + " && {" + command +
                               "; code=$?; echo %; ls -A '" + mount_point.string() + "'; exit $code; }";
    return fixture_.Run({"unshare", unshare_flags_, "sh", "-c", script});
  }
  static std::vector<std::string> NamesLeft(const Completed& run) {
    const auto at = run.stdout_text.find('%');
    return at == std::string::npos ? std::vector<std::string>{"the script did not get that far"} : Lines(run.stdout_text.substr(at + 1));
  }

  std::string unshare_flags_;
};

TEST_F(FullDiskTest, RefusesAReadOnlyOutputFolder) {
  const fs::path frames = FolderWithAnImage();
  const fs::path out = fixture_.NewFolder("out");
  const Completed run = RunOnTmpfs(out, "mount -o remount,ro '" + out.string() + "'",
                                   RunFixture::RunArguments(frames, out / "mosaic.tif", {"--quiet"}), "size=64k");
  ExpectOneMessage(run, out.string(), 3);
  EXPECT_THAT(NamesLeft(run), IsEmpty());
}

TEST_F(FullDiskTest, FailsCleanlyWhenTheDiskIsFullInTheMiddle) {
  const fs::path spec = fixture_.SimulateSortie("sortie", kFrameCount) / "sortie.textproto";
  const fs::path out = fixture_.NewFolder("out");
  const Completed run =
      RunOnTmpfs(out, "true", RunFixture::RunArguments(spec, out / "mosaic.tif", {"--workers", "2", "--quiet"}), "size=1500k");
  EXPECT_EQ(run.exit_code, 1);
  EXPECT_EQ(Lines(run.stderr_text).size(), 1u) << run.stderr_text;
  EXPECT_THAT(run.stderr_text, ::testing::AnyOf(HasSubstr("No space left"), HasSubstr("full")));
  EXPECT_EQ(NamesLeft(run), std::vector<std::string>{"mosaic.tif.work"});
  EXPECT_THAT(run.orphans, IsEmpty());
  EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
}

TEST_F(FullDiskTest, PublishesNothingWhenTheResultsDoNotFit) {
  const fs::path spec = fixture_.SimulateSortie("sortie", kFrameCount) / "sortie.textproto";
  const fs::path out = fixture_.NewFolder("out");
  const fs::path work = fixture_.folder() / "work";
  const Completed run =
      RunOnTmpfs(out, "true", RunFixture::RunArguments(spec, out / "mosaic.tif", {"--quiet", "--work-dir", work.string()}), "size=32k");
  EXPECT_EQ(run.exit_code, 1);
  EXPECT_EQ(Lines(run.stderr_text).size(), 1u) << run.stderr_text;
  EXPECT_THAT(run.stderr_text, HasSubstr("No space left"));
  EXPECT_THAT(run.stderr_text, HasSubstr("the same command resumes"));
  EXPECT_THAT(NamesLeft(run), IsEmpty());
  EXPECT_THAT(run.orphans, IsEmpty());
}

}  // namespace
}  // namespace trem::testing
