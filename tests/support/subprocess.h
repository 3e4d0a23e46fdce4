#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace trem::testing {

struct SubprocessOptions {
  std::vector<std::string> environment;  // "NAME=value", added to this process' own.
  std::filesystem::path folder;          // Working folder; empty: this process'.
  bool own_process_group = false;        // True: signals to the group of the test do not reach it.
};

// How a process ended.
struct Exit {
  int code = -1;   // 128 + signal when a signal ended it.
  int signal = 0;  // 0: it exited by itself.
};

// A child process with captured output. The child and everything that it starts carry a unique environment variable, by which
// descendants are found even after they were re-parented. The destructor kills what is left, so a failing test leaves nothing behind;
// neither does one that is killed: the child ends with the thread that started it.
class Subprocess {
 public:
  // `argv[0]` is a path, or a name that is looked up in PATH.
  explicit Subprocess(std::vector<std::string> argv, const SubprocessOptions& options = {});
  ~Subprocess();
  Subprocess(const Subprocess&) = delete;
  Subprocess& operator=(const Subprocess&) = delete;

  pid_t pid() const { return pid_; }
  // Nullopt when it has not ended in time. May be called again.
  std::optional<Exit> Wait(std::chrono::milliseconds timeout);
  void Signal(int signal_number) const;

  // What it and its descendants have written so far.
  std::string Stdout() const;
  std::string Stderr() const;

  // Processes (the child excepted) that were started by the child, directly or not, and have not ended; zombies do not count.
  std::vector<pid_t> Descendants() const;
  // As Descendants, but waits up to `timeout` for the list to become empty.
  std::vector<pid_t> DescendantsAfter(std::chrono::milliseconds timeout) const;

 private:
  std::string marker_;
  pid_t pid_ = -1;
  int stdout_fd_ = -1;
  int stderr_fd_ = -1;
  std::optional<Exit> exit_;
};

// Runs a program to its end.
struct Completed {
  bool ended = false;  // False: it was killed after the timeout.
  int exit_code = -1;
  std::string stdout_text;
  std::string stderr_text;
  std::vector<pid_t> orphans;  // Descendants alive 2 s after the end.
};
Completed RunProgram(std::vector<std::string> argv, std::chrono::milliseconds timeout, const SubprocessOptions& options = {});

// Command line of a process, arguments separated by spaces; empty when it is gone.
std::string CommandLine(pid_t pid);

}  // namespace trem::testing
