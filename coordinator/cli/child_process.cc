#include "coordinator/cli/child_process.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <system_error>

#include "mosaic/base/file.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

// Runs in the forked child: only calls that are safe there. Reports errno through `report_fd`, which exec closes.
[[noreturn]] void ExecChild(char* const* argv, int log_fd, int report_fd, pid_t parent) {
  ::setpgid(0, 0);
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);  // The parent ended before the line above.
  for (const int signal_number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) ::signal(signal_number, SIG_DFL);
  const int null = ::open("/dev/null", O_RDONLY);
  if (null >= 0 && ::dup2(null, STDIN_FILENO) >= 0 && ::dup2(log_fd, STDOUT_FILENO) >= 0 && ::dup2(log_fd, STDERR_FILENO) >= 0) {
    ::execv(argv[0], argv);
  }
  const int error_number = errno;
  (void)!::write(report_fd, &error_number, sizeof(error_number));
  ::_exit(127);
}

}  // namespace

Result<pid_t> StartChild(const std::vector<std::string>& argv, const fs::path& log_path) {
  const int log_fd = ::open(log_path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (log_fd < 0) return FromErrno("cannot open log " + log_path.string(), errno);
  int report[2];
  if (::pipe2(report, O_CLOEXEC) != 0) {
    const int error_number = errno;
    ::close(log_fd);
    return FromErrno("cannot make a pipe to start " + argv[0], error_number);
  }
  std::vector<char*> pointers;
  for (const std::string& argument : argv) pointers.push_back(const_cast<char*>(argument.c_str()));
  pointers.push_back(nullptr);
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  const int fork_error = errno;
  if (pid == 0) ExecChild(pointers.data(), log_fd, report[1], parent);
  ::close(log_fd);
  ::close(report[1]);
  int exec_error = 0;
  ssize_t count = 0;
  if (pid > 0) {
    do {
      count = ::read(report[0], &exec_error, sizeof(exec_error));
    } while (count < 0 && errno == EINTR);
  }
  ::close(report[0]);
  if (pid < 0) return FromErrno("cannot start " + argv[0], fork_error);
  if (count == static_cast<ssize_t>(sizeof(exec_error))) {
    ::waitpid(pid, nullptr, 0);
    return Failed("cannot start " + argv[0] + ": " + std::strerror(exec_error) + "; is the installation complete?");
  }
  return pid;
}

std::string DescribeExit(int wait_status) {
  if (WIFSIGNALED(wait_status)) {
    const int signal_number = WTERMSIG(wait_status);
    return "was killed by signal " + std::to_string(signal_number) + " (" + ::strsignal(signal_number) + ")";
  }
  return "exited with code " + std::to_string(WEXITSTATUS(wait_status));
}

std::optional<int> ReapChild(pid_t pid) {
  int wait_status = 0;
  if (::waitpid(pid, &wait_status, WNOHANG) == pid) return wait_status;
  return std::nullopt;
}

std::string LastLines(const fs::path& path, int line_count) {
  constexpr std::streamoff kBytesMax = 4096;
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  if (!in) return {};
  const std::streamoff size = in.tellg();
  in.seekg(std::max<std::streamoff>(0, size - kBytesMax));
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) {
    if (!line.empty()) lines.push_back(line);
  }
  const std::size_t first = lines.size() - std::min(lines.size(), static_cast<std::size_t>(line_count));
  std::string text;
  for (std::size_t i = first; i < lines.size(); ++i) text += (text.empty() ? "" : "\n") + lines[i];
  return text;
}

Result<fs::path> ProgramFolder() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (error) return FromErrno("cannot read /proc/self/exe", error.value());
  return program.parent_path();
}

Result<std::string> OutputOf(const std::vector<std::string>& argv) {
  std::string log = (fs::temp_directory_path() / "trem-output-XXXXXX").string();
  const int fd = ::mkstemp(log.data());
  if (fd < 0) return FromErrno("cannot make a file like " + log, errno);
  ::close(fd);
  const Result<pid_t> pid = StartChild(argv, log);
  int status = -1;
  if (pid.ok()) ::waitpid(*pid, &status, 0);
  Result<std::string> text = ReadFile(log, 65536);
  const std::string last = LastLines(log, 1);
  std::error_code ignored;
  fs::remove(log, ignored);
  if (!pid.ok()) return pid.status();
  if (status != 0) return Failed(last.empty() ? argv.front() + " " + DescribeExit(status) : last);
  return text;
}

}  // namespace trem
