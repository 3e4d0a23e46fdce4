#include "tests/e2e/run_fixture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>

namespace trem::testing {
namespace fs = std::filesystem;
namespace {

constexpr std::chrono::minutes kPatience{8};

}  // namespace

RunFixture::RunFixture() { fs::create_directories(folder_ / "runtime"); }

SubprocessOptions RunFixture::Options() const { return {{"XDG_RUNTIME_DIR=" + (folder_ / "runtime").string()}, {}, true}; }

Completed RunFixture::Run(const std::vector<std::string>& argv) const {
  Completed completed = RunProgram(argv, kPatience, Options());
  EXPECT_TRUE(completed.ended) << argv[0] << " " << argv[1] << " did not end\n" << completed.stderr_text;
  return completed;
}

fs::path RunFixture::SimulateSortie(const std::string& name, int frame_count, const std::vector<std::string>& more) {
  const fs::path sortie = folder_ / name;
  std::vector<std::string> argv = {BinaryPath("trem").string(),
                                   "simulate",
                                   "-o",
                                   sortie.string(),
                                   "--quiet",
                                   "--width",
                                   "128",
                                   "--height",
                                   "100",
                                   "--frames",
                                   std::to_string(frame_count),
                                   "--speed-px",
                                   "2",
                                   "--terrain-width",
                                   "800",
                                   "--terrain-height",
                                   "800"};
  argv.insert(argv.end(), more.begin(), more.end());
  const Completed completed = Run(argv);
  EXPECT_EQ(completed.exit_code, 0) << completed.stderr_text;
  return sortie;
}

fs::path RunFixture::FramesFolder(const fs::path& sortie) { return sortie / "frames"; }

std::vector<fs::path> RunFixture::Frames(const fs::path& sortie) {
  std::vector<fs::path> frames;
  for (const auto& entry : fs::directory_iterator(FramesFolder(sortie))) {
    if (entry.path().extension() == ".png") frames.push_back(entry.path());
  }
  std::sort(frames.begin(), frames.end());
  return frames;
}

fs::path RunFixture::NewFolder(const std::string& name) const {
  const fs::path path = folder_ / name;
  EXPECT_TRUE(fs::create_directories(path)) << path;
  return path;
}

std::vector<std::string> RunFixture::RunArguments(const fs::path& source, const fs::path& output, const std::vector<std::string>& more) {
  std::vector<std::string> argv = {BinaryPath("trem").string(), "run", source.string(), "-o", output.string()};
  for (const char* setting :
       {"windows.roi_px=81", "windows.roi_overlap_px=30", "windows.frames=16", "windows.frame_overlap=6", "mosaic.tile_px=256"}) {
    argv.insert(argv.end(), {"--set", setting});
  }
  argv.insert(argv.end(), more.begin(), more.end());
  return argv;
}

bool RunFixture::RuntimeFolderIsEmpty() const { return fs::is_empty(folder_ / "runtime"); }

namespace {

// Takes the one table of times out of a report.
void CutTimes(std::string* html) {
  const std::size_t begin = html->find("<h2>Times</h2>");
  ASSERT_NE(begin, std::string::npos) << "a published report tells its times";
  const std::size_t end = html->find("</p>\n", begin);
  ASSERT_NE(end, std::string::npos);
  html->erase(begin, end - begin);
}

}  // namespace

std::map<std::string, std::string> FilesIn(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    std::string& bytes = files[entry.path().filename()];
    bytes = FileContents(entry.path());
    if (entry.path().filename().string().ends_with("_report.html")) CutTimes(&bytes);
  }
  return files;
}

std::vector<std::string> NamesIn(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder, ignored)) names.push_back(entry.path().filename());
  std::sort(names.begin(), names.end());
  return names;
}

int StoredObjectCount(const fs::path& work_folder) {
  int count = 0;
  std::error_code error;
  for (fs::recursive_directory_iterator it(work_folder / "store" / "objects", error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    if (it->is_regular_file(ignored)) ++count;
  }
  return count;
}

std::vector<std::string> Lines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    if (!line.empty()) lines.push_back(line);
  }
  return lines;
}

}  // namespace trem::testing
