#pragma once

#include <sys/types.h>

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// Starts `argv` (argv[0] is a path) as a child in a process group of its own, so that Ctrl-C reaches only this process. Its standard
// input is empty; both outputs are appended to `log_path`. The kernel kills the child when this process ends, however it ends. Must be
// called by the main thread (the kernel watches the starting thread). Errors, exec's included, name the program.
Result<pid_t> StartChild(const std::vector<std::string>& argv, const std::filesystem::path& log_path);

// How a child ended, in words: "exited with code 1" or "was killed by signal 9 (Killed)".
std::string DescribeExit(int wait_status);

// The wait status of child `pid` when it has ended (and reaps it), else nullopt.
std::optional<int> ReapChild(pid_t pid);

// Runs a short command to its end: what it prints on both outputs, the first 64 KiB. A failure is an error with the last line. Called as
// StartChild.
Result<std::string> OutputOf(const std::vector<std::string>& argv);

// The last lines of a text file, at most `line_count` of them and 4 KiB; empty when there are none.
std::string LastLines(const std::filesystem::path& path, int line_count);

// Folder of the running program: its siblings trem-coordinator and trem-worker are there.
Result<std::filesystem::path> ProgramFolder();

}  // namespace trem
