#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem::testing {

// A small simulated sortie and the commands on it. Every process gets $XDG_RUNTIME_DIR inside the fixture's folder, so that a socket folder
// left behind is seen.
class RunFixture {
 public:
  RunFixture();

  // Renders `frame_count` frames (128 x 100 px) with telemetry into a new folder and returns it; the folder holds sortie.textproto.
  // Fails the running test when that does not work.
  std::filesystem::path SimulateSortie(const std::string& name, int frame_count, const std::vector<std::string>& more = {});
  // The folder of the PNG frames of a simulated sortie.
  static std::filesystem::path FramesFolder(const std::filesystem::path& sortie);
  // Sorted paths of the frames.
  static std::vector<std::filesystem::path> Frames(const std::filesystem::path& sortie);

  // A new, empty folder.
  std::filesystem::path NewFolder(const std::string& name) const;
  // "trem run SOURCE -o OUTPUT" with windows so small that a little sortie has many tasks; then `more`.
  static std::vector<std::string> RunArguments(const std::filesystem::path& source, const std::filesystem::path& output,
                                               const std::vector<std::string>& more = {});
  SubprocessOptions Options() const;
  Completed Run(const std::vector<std::string>& argv) const;

  // No socket folder of a run is left.
  bool RuntimeFolderIsEmpty() const;
  const TempDir& folder() const { return folder_; }

 private:
  TempDir folder_;
};

// Name -> bytes of all files in `folder` (not its subfolders); of a report without its table of times, which no two runs share.
std::map<std::string, std::string> FilesIn(const std::filesystem::path& folder);
std::vector<std::string> NamesIn(const std::filesystem::path& folder);

// Objects in the artefact store of a work folder: how far a run has come, seen from outside.
int StoredObjectCount(const std::filesystem::path& work_folder);

// Lines of what a command wrote, without empty ones.
std::vector<std::string> Lines(const std::string& text);

}  // namespace trem::testing
