// Goal: `trem simulate` does what its help says: exit codes, one clear message an error, nothing half-written, and output that the
// documented file layout describes. Method: the command function is called as main calls it, with small procedural terrains, inside a
// temporary folder; files are read back.
#include "worker/app/simulate_command.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "proto/codec/sortie_spec.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::StartsWith;
using trem::testing::FileContents;
using trem::testing::TempDir;

struct Outcome {
  int code = -1;
  std::string out;
  std::string err;
};

Outcome RunCommand(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "trem simulate");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  Outcome outcome;
  outcome.code = RunSimulateCommand(static_cast<int>(argv.size()), argv.data());
  outcome.out = ::testing::internal::GetCapturedStdout();
  outcome.err = ::testing::internal::GetCapturedStderr();
  return outcome;
}

std::vector<std::string> Small(const fs::path& directory, const std::vector<std::string>& more = {}) {
  std::vector<std::string> arguments = {
      "-o",  directory.string(), "--width", "40",     "--height", "32", "--frames", "5", "--terrain-width",
      "300", "--terrain-height", "200",     "--quiet"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST(SimulateCommand, NamesThePathsThatThereAre) {
  const TempDir temp;
  for (const char* path : {"line", "lawnmower", "dwell"}) {
    EXPECT_EQ(RunCommand(Small(temp / path, {"--path", path, "--sidelap", "0.6", "--frames", "40"})).code, 0) << path;
  }
  const Outcome outcome = RunCommand(Small(temp / "sortie", {"--path", "zigzag"}));
  EXPECT_EQ(outcome.code, 2);
  EXPECT_EQ(outcome.err, "trem simulate: --path: 'zigzag' is not a path; expected line, lawnmower or dwell. See 'trem simulate --help'\n");
  EXPECT_FALSE(fs::exists(temp / "sortie"));
}

TEST(SimulateCommand, LeavesFramesTelemetryTruthAndASpec) {
  const TempDir temp;
  const Outcome outcome = RunCommand(Small(temp / "sortie"));
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr("5 frames of 40 x 32 px"));
  for (const char* name : {"frames/00000.png", "frames/00004.png", "truth/truth.tif", "truth/frames.csv", "truth/simulation.json"}) {
    EXPECT_TRUE(fs::exists(temp / "sortie" / name)) << name;
  }
  EXPECT_THAT(FileContents(temp / "sortie" / "frames" / "telemetry.csv"),
              StartsWith("frame,time_s,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg,vfov_deg,ground_elevation_"
                         "m\n00000.png,"));
  // The spec, and the bare folder, are what `trem run` takes.
  for (const fs::path& argument : {temp / "sortie" / "sortie.textproto", temp / "sortie" / "frames"}) {
    const Result<v1::Sortie> spec = LoadSortie(argument.string(), {});
    ASSERT_TRUE(spec.ok()) << spec.status().message();
    EXPECT_TRUE(fs::equivalent(spec->source().path(), temp / "sortie" / "frames"));
    EXPECT_GT(spec->sensor().fill_factor(), 0.0) << "zero stands for the default";
  }
}

TEST(SimulateCommand, RefusesAFolderWithContentUnlessToldToOverwriteASimulation) {
  const TempDir temp;
  ASSERT_EQ(RunCommand(Small(temp / "sortie")).code, 0);
  const Outcome again = RunCommand(Small(temp / "sortie"));
  EXPECT_EQ(again.code, 3);
  EXPECT_THAT(again.err, HasSubstr("is not empty"));
  EXPECT_EQ(RunCommand(Small(temp / "sortie", {"--overwrite", "--frames", "3"})).code, 0);
  EXPECT_FALSE(fs::exists(temp / "sortie" / "frames" / "00004.png"));

  fs::create_directory(temp / "other");
  trem::testing::WriteFileContents(temp / "other" / "precious.txt", "keep me");
  const Outcome other = RunCommand(Small(temp / "other", {"--overwrite"}));
  EXPECT_EQ(other.code, 3);
  EXPECT_THAT(other.err, HasSubstr("something else than a simulation"));
  EXPECT_EQ(FileContents(temp / "other" / "precious.txt"), "keep me");
}

TEST(SimulateCommand, ReportsBadInputWithCodeThreeAndLeavesNothing) {
  const TempDir temp;
  trem::testing::WriteFileContents(temp / "text.png", "this is no picture");
  const struct {
    std::vector<std::string> more;
    const char* message;
  } cases[] = {{{(temp / "missing.png").string()}, "no such file"},
               {{(temp / "text.png").string()}, "is not an image"},
               {{"--pitch-deg", "-20"}, "--pitch-deg is -20; it must be from -90 to -30"},
               {{"--bits", "12"}, "--bits is 12; it must be 8 or 16"},
               {{"--gsd", "nan"}, "--gsd is nan"},
               {{"--width", "400"}, "use a smaller --width"},
               {{"--frames", "500", "--speed-px", "3"}, "--frames 1"}};
  for (const auto& bad : cases) {
    const Outcome outcome = RunCommand(Small(temp / "sortie", bad.more));
    EXPECT_EQ(outcome.code, 3) << bad.message;
    EXPECT_THAT(outcome.err, HasSubstr(bad.message));
    EXPECT_FALSE(fs::exists(temp / "sortie")) << bad.message;
  }
  for (const auto& entry : fs::directory_iterator(temp.path())) EXPECT_EQ(entry.path().filename(), "text.png");
}

TEST(SimulateCommand, ReportsUsageErrorsWithCodeTwoAndHelpWithCodeZero) {
  EXPECT_EQ(RunCommand({}).code, 2);
  EXPECT_EQ(RunCommand({"-o", "x", "--no-such-option"}).code, 2);
  EXPECT_EQ(RunCommand({"-o", "x", "--path", "spiral"}).code, 2);
  const Outcome help = RunCommand({"--help"});
  EXPECT_EQ(help.code, 0);
  EXPECT_THAT(help.out, HasSubstr("Examples:"));
}

}  // namespace
}  // namespace trem
