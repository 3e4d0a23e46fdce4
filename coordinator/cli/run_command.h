#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace trem {

// `trem run`.
struct RunOptions {
  std::string sortie;            // Spec, video, folder or glob.
  std::filesystem::path output;  // The mosaic; its siblings go beside it.
  int worker_count = 1;
  std::vector<std::string> overrides;  // "tre.ratio=3".
  std::filesystem::path work_folder;   // Empty: `<output>.work`.
  bool keep_work = false;
  bool json = false;   // One JSON object on stdout.
  bool quiet = false;  // No progress, no summary; warnings and errors stay.
};

// Cores that this process may use.
int DefaultWorkerCount();

// Does one job on this machine: starts a coordinator and workers, submits, waits, publishes, stops them. Returns the exit code.
int RunRunCommand(const RunOptions& options);

}  // namespace trem
