#include "tests/support/subprocess.h"

#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <thread>
#include <utility>

#include "mosaic/base/check.h"

extern char** environ;

namespace trem::testing {
namespace {

using std::chrono::steady_clock;

std::string ReadProcFile(pid_t pid, const char* name) {
  std::ifstream in("/proc/" + std::to_string(pid) + "/" + name, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

std::string ReadCapture(int fd) {
  std::string text;
  char block[65536];
  for (;;) {
    const ssize_t count = ::pread(fd, block, sizeof(block), static_cast<off_t>(text.size()));
    if (count <= 0) return text;
    text.append(block, static_cast<std::size_t>(count));
  }
}

// Only the calls that are safe between fork and exec.
[[noreturn]] void RunChild(char* const* argv, char* const* environment, const char* folder, bool own_process_group, int out, int err,
                           pid_t parent) {
  // A test or bench that is ended by a time limit leaves nothing behind.
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);
  if (own_process_group) ::setpgid(0, 0);
  const int null = ::open("/dev/null", O_RDONLY);
  ::dup2(null, STDIN_FILENO);
  ::dup2(out, STDOUT_FILENO);
  ::dup2(err, STDERR_FILENO);
  if (*folder == '\0' || ::chdir(folder) == 0) ::execvpe(argv[0], argv, environment);
  const char* reason = std::strerror(errno);
  (void)!::write(STDERR_FILENO, reason, std::strlen(reason));
  ::_exit(127);
}

}  // namespace

Subprocess::Subprocess(std::vector<std::string> argv, const SubprocessOptions& options) {
  static std::atomic<int> counter{0};
  marker_ = "TREM_TEST_PROCESS=" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1));
  std::vector<std::string> environment = options.environment;
  environment.push_back(marker_);
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string name(*entry, std::strcspn(*entry, "=") + 1);
    const auto same_name = [&](const std::string& added) { return added.compare(0, name.size(), name) == 0; };
    if (std::none_of(environment.begin(), environment.end(), same_name)) environment.emplace_back(*entry);
  }
  std::vector<char*> argument_pointers, environment_pointers;
  for (std::string& argument : argv) argument_pointers.push_back(argument.data());
  for (std::string& entry : environment) environment_pointers.push_back(entry.data());
  argument_pointers.push_back(nullptr);
  environment_pointers.push_back(nullptr);
  stdout_fd_ = ::memfd_create("stdout", MFD_CLOEXEC);
  stderr_fd_ = ::memfd_create("stderr", MFD_CLOEXEC);
  TREM_CHECK(stdout_fd_ >= 0 && stderr_fd_ >= 0);
  const std::string folder = options.folder.string();
  const pid_t parent = ::getpid();
  pid_ = ::fork();
  TREM_CHECK_MSG(pid_ >= 0, std::strerror(errno));
  if (pid_ == 0) {
    RunChild(argument_pointers.data(), environment_pointers.data(), folder.c_str(), options.own_process_group, stdout_fd_, stderr_fd_,
             parent);
  }
}

Subprocess::~Subprocess() {
  if (!exit_) {
    ::kill(pid_, SIGKILL);
    Wait(std::chrono::seconds(10));
  }
  for (const pid_t descendant : Descendants()) ::kill(descendant, SIGKILL);
  ::close(stdout_fd_);
  ::close(stderr_fd_);
}

std::optional<Exit> Subprocess::Wait(std::chrono::milliseconds timeout) {
  const auto deadline = steady_clock::now() + timeout;
  while (!exit_) {
    int state = 0;
    const pid_t ended = ::waitpid(pid_, &state, WNOHANG);
    TREM_CHECK(ended >= 0);
    if (ended == pid_) {
      exit_ = WIFSIGNALED(state) ? Exit{128 + WTERMSIG(state), WTERMSIG(state)} : Exit{WEXITSTATUS(state), 0};
    } else if (steady_clock::now() >= deadline) {
      return std::nullopt;
    } else {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  return exit_;
}

void Subprocess::Signal(int signal_number) const {
  if (!exit_) ::kill(pid_, signal_number);
}

std::string Subprocess::Stdout() const { return ReadCapture(stdout_fd_); }
std::string Subprocess::Stderr() const { return ReadCapture(stderr_fd_); }

std::vector<pid_t> Subprocess::Descendants() const {
  std::vector<pid_t> found;
  DIR* proc = ::opendir("/proc");
  TREM_CHECK(proc != nullptr);
  while (const dirent* entry = ::readdir(proc)) {
    const pid_t pid = std::atoi(entry->d_name);
    if (pid <= 0 || pid == pid_) continue;
    const std::string environment = ReadProcFile(pid, "environ");  // Empty for zombies.
    const std::string wanted = marker_ + '\0';
    const auto at = environment.find(wanted);
    if (at != std::string::npos && (at == 0 || environment[at - 1] == '\0')) found.push_back(pid);
  }
  ::closedir(proc);
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<pid_t> Subprocess::DescendantsAfter(std::chrono::milliseconds timeout) const {
  const auto deadline = steady_clock::now() + timeout;
  for (;;) {
    std::vector<pid_t> found = Descendants();
    if (found.empty() || steady_clock::now() >= deadline) return found;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

Completed RunProgram(std::vector<std::string> argv, std::chrono::milliseconds timeout, const SubprocessOptions& options) {
  Subprocess process(std::move(argv), options);
  Completed completed;
  if (const auto exit = process.Wait(timeout)) {
    completed.ended = true;
    completed.exit_code = exit->code;
    completed.orphans = process.DescendantsAfter(std::chrono::seconds(2));
  }
  completed.stdout_text = process.Stdout();
  completed.stderr_text = process.Stderr();
  return completed;
}

std::string CommandLine(pid_t pid) {
  std::string text = ReadProcFile(pid, "cmdline");
  std::replace(text.begin(), text.end(), '\0', ' ');
  return text;
}

}  // namespace trem::testing
