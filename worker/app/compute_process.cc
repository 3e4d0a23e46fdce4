#include "worker/app/compute_process.h"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <utility>

#include "mosaic/base/log.h"

namespace trem {
namespace {

using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

constexpr int kChildFd = 3;
constexpr milliseconds kPoll{100};

TaskOutcome OutcomeOf(const v1::Done& done) {
  const auto code = static_cast<StatusCode>(done.status_code());
  const bool is_known = done.status_code() <= static_cast<std::uint32_t>(StatusCode::kFailed);
  TaskOutcome outcome = !is_known                 ? TaskOutcome(Failed("the compute process reports an unknown failure"))
                        : code == StatusCode::kOk ? TaskOutcome(done.result())
                                                  : TaskOutcome(Status(code, done.message()));
  outcome.peak_memory_bytes = done.peak_memory_bytes();
  outcome.bad_artefacts.assign(done.bad_artefacts().begin(), done.bad_artefacts().end());
  return outcome;
}

std::string TitleOf(const v1::TaskSpec& spec) { return v1::TaskKind_Name(spec.kind()) + " task"; }

}  // namespace

ComputeProcess::~ComputeProcess() { Reap(true); }

Status ComputeProcess::EnsureStarted() {
  if (pid_ > 0) {
    // It may have died while it slept.
    if (::waitpid(pid_, nullptr, WNOHANG) == 0) return {};
    pid_ = -1;
    Reap(false);
  }
  std::array<int, 2> pair{};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair.data()) != 0) return FromErrno("cannot make a socket pair", errno);
  std::vector<std::string> argv = options_.argv;
  argv.insert(argv.end(), {"--fd", std::to_string(kChildFd)});
  std::vector<char*> pointers;
  for (std::string& argument : argv) pointers.push_back(argument.data());
  pointers.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  // When the numbers are the same, dup2 would leave the descriptor to be closed at exec.
  const int other = pair[1] == kChildFd ? ::fcntl(pair[1], F_DUPFD_CLOEXEC, kChildFd + 1) : pair[1];
  ::posix_spawn_file_actions_adddup2(&actions, other, kChildFd);
  std::array<int, 2> errors{-1, -1};
  if (options_.on_stderr && ::pipe2(errors.data(), O_CLOEXEC) == 0) {
    (void)::fcntl(errors[0], F_SETFL, O_NONBLOCK);
    ::posix_spawn_file_actions_adddup2(&actions, errors[1], STDERR_FILENO);
  }
  const int error = ::posix_spawn(&pid_, argv[0].c_str(), &actions, nullptr, pointers.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  if (other != pair[1]) ::close(other);
  ::close(pair[1]);
  if (errors[1] >= 0) ::close(errors[1]);
  fd_ = pair[0];
  stderr_fd_ = errors[0];
  reader_ = {};
  if (error == 0) return {};
  pid_ = -1;
  Reap(false);
  return FromErrno("cannot start " + argv[0], error);
}

int ComputeProcess::Reap(bool kill) {
  int status = 0;
  if (pid_ > 0) {
    if (kill) ::kill(pid_, SIGKILL);
    while (::waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
    }
    pid_ = -1;
  }
  if (fd_ >= 0) ::close(std::exchange(fd_, -1));
  RelayStderr();  // Its last words.
  if (stderr_fd_ >= 0) ::close(std::exchange(stderr_fd_, -1));
  return status;
}

void ComputeProcess::RelayStderr() {
  if (stderr_fd_ < 0) return;
  std::array<char, 4096> buffer;
  for (int i = 0; i < 64; ++i) {  // A child that never stops writing does not stop this process.
    const ssize_t count = ::read(stderr_fd_, buffer.data(), buffer.size());
    if (count == 0) ::close(std::exchange(stderr_fd_, -1));  // Or poll would never wait again.
    if (count <= 0) return;
    const std::string_view bytes(buffer.data(), static_cast<std::size_t>(count));
    (void)!::write(STDERR_FILENO, bytes.data(), bytes.size());
    options_.on_stderr(bytes);
  }
}

TaskOutcome ComputeProcess::Death(const v1::TaskSpec& spec) {
  const int status = Reap(false);
  const std::string what = TitleOf(spec) + ": its compute process ";
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
    return Exhausted(what + "was killed; most likely it took more memory than there is");
  }
  if (WIFSIGNALED(status)) {
    return Failed(what + "ended by signal " + std::to_string(WTERMSIG(status)) + " (" + ::strsignal(WTERMSIG(status)) + ")");
  }
  return Failed(what + "exited with code " + std::to_string(WEXITSTATUS(status)));
}

void ComputeProcess::SetProcessors(int processors) {
  if (processors_.exchange(processors) != processors) wake_.Notify();
}

TaskOutcome ComputeProcess::Run(const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
  TREM_RETURN_IF_ERROR(EnsureStarted());
  TaskOutcome outcome = Await(spec, progress);
  // Whoever ran out of memory may have left things half done.
  if (!outcome.result.ok() && outcome.result.status().code() == StatusCode::kExhausted) Reap(true);
  return outcome;
}

TaskOutcome ComputeProcess::Await(const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
  if (!SendComputeFrame(fd_, ComputeFrameKind::kTask, spec.SerializeAsString()).ok()) return Death(spec);
  int processors_told = 1;
  const Clock::time_point start = Clock::now();
  Clock::time_point last_news = start;
  std::optional<Clock::time_point> kill_at;
  for (;;) {
    // A negative one is left out.
    std::array<pollfd, 3> items{pollfd{fd_, POLLIN, 0}, pollfd{stderr_fd_, POLLIN, 0}, pollfd{wake_.fd(), POLLIN, 0}};
    (void)::poll(items.data(), items.size(), static_cast<int>(kPoll.count()));
    if (items[1].revents != 0) RelayStderr();
    if (items[2].revents != 0) wake_.Clear();
    const bool is_there = reader_.ReadAvailable(fd_);
    const Clock::time_point now = Clock::now();
    bool goes_on = progress(-1.0);
    for (;;) {
      auto frame = reader_.Next();
      if (!frame.ok()) {
        Reap(true);
        return frame.status();
      }
      if (!frame->has_value()) break;
      last_news = now;
      if ((*frame)->kind == ComputeFrameKind::kProgress) goes_on &= progress(std::strtod((*frame)->body.c_str(), nullptr));
      if ((*frame)->kind != ComputeFrameKind::kDone) continue;
      RelayStderr();  // What it said before it was done.
      v1::Done done;
      if (done.ParseFromString((*frame)->body)) return OutcomeOf(done);
      Reap(true);
      return Corrupt("the compute process sent a result that cannot be read");
    }
    if (!is_there) return Death(spec);
    if (const int processors = processors_; processors != std::exchange(processors_told, processors)) {
      (void)SendComputeFrame(fd_, ComputeFrameKind::kShare, std::to_string(processors));
    }
    if (!goes_on && !kill_at) {
      kill_at = now + options_.cancel_grace;
      (void)SendComputeFrame(fd_, ComputeFrameKind::kCancel, "");
    }
    if (kill_at && now >= *kill_at) {
      Reap(true);
      return Cancelled(TitleOf(spec) + " was cancelled and did not stop; its process was killed");
    }
    if (now - last_news > options_.silence_max) {
      Reap(true);
      return Failed(TitleOf(spec) + " made no progress for " + std::to_string(options_.silence_max.count() / 1000) +
                    " s; its process was killed");
    }
    if (options_.task_max.count() > 0 && now - start > options_.task_max) {
      Reap(true);
      return Failed(TitleOf(spec) + " took more than " + std::to_string(options_.task_max.count() / 1000) + " s; its process was killed");
    }
  }
}

}  // namespace trem
