#include "worker/app/compute_protocol.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <deque>
#include <mutex>
#include <thread>

#include "mosaic/base/parallel.h"

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kHeadBytes = 5;
constexpr std::uint32_t kBodyBytesMax = 256U << 20;
constexpr std::chrono::milliseconds kProgressInterval{50};

bool IsKind(char kind) { return kind == 'T' || kind == 'C' || kind == 'S' || kind == 'P' || kind == 'D'; }

std::uint64_t OwnPeakMemoryBytes() {
  rusage usage{};
  return ::getrusage(RUSAGE_SELF, &usage) == 0 ? static_cast<std::uint64_t>(usage.ru_maxrss) * 1024 : 0;
}

// The child's ears: hears Cancel and the parent's death while the main thread computes.
class Listener {
 public:
  explicit Listener(int fd) : fd_(fd), thread_([this] { Listen(); }) { thread_.detach(); }

  v1::TaskSpec AwaitTask() {
    std::unique_lock lock(mutex_);
    has_task_.wait(lock, [this] { return !tasks_.empty(); });
    v1::TaskSpec spec = std::move(tasks_.front());
    tasks_.pop_front();
    return spec;
  }
  bool is_cancelled() const { return is_cancelled_; }

 private:
  void Listen() {
    ComputeFrameReader reader;
    for (;;) {
      pollfd item{fd_, POLLIN, 0};
      if (::poll(&item, 1, -1) < 0 && errno != EINTR) ::_exit(1);
      // The parent is gone, and with it whoever wants a result. Whatever the main thread is stuck in ends here too.
      if (!reader.ReadAvailable(fd_)) ::_exit(0);
      for (;;) {
        auto frame = reader.Next();
        if (!frame.ok()) ::_exit(1);
        if (!frame->has_value()) break;
        if ((*frame)->kind == ComputeFrameKind::kCancel) is_cancelled_ = true;
        if ((*frame)->kind == ComputeFrameKind::kShare) SetThreadsMax(static_cast<int>(std::strtol((*frame)->body.c_str(), nullptr, 10)));
        if ((*frame)->kind != ComputeFrameKind::kTask) continue;
        v1::TaskSpec spec;
        if (!spec.ParseFromString((*frame)->body)) ::_exit(1);
        SetThreadsMax(1);
        const std::lock_guard lock(mutex_);
        is_cancelled_ = false;
        tasks_.push_back(std::move(spec));
        has_task_.notify_one();
      }
    }
  }

  int fd_;
  std::atomic<bool> is_cancelled_{false};
  std::mutex mutex_;
  std::condition_variable has_task_;
  std::deque<v1::TaskSpec> tasks_;
  std::thread thread_;
};

}  // namespace

Status SendComputeFrame(int fd, ComputeFrameKind kind, std::string_view body) {
  const auto size = static_cast<std::uint32_t>(body.size());
  if (body.size() > kBodyBytesMax) return Failed("a message of " + std::to_string(body.size()) + " bytes for the compute process");
  std::string frame(1, static_cast<char>(kind));
  for (int shift = 0; shift < 32; shift += 8) frame += static_cast<char>((size >> shift) & 0xff);
  frame += body;
  for (std::size_t sent = 0; sent < frame.size();) {
    const ssize_t count = ::send(fd, frame.data() + sent, frame.size() - sent, MSG_NOSIGNAL);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return Unavailable("the other process is gone");
    sent += static_cast<std::size_t>(count);
  }
  return {};
}

bool ComputeFrameReader::ReadAvailable(int fd) {
  std::array<char, 1 << 16> buffer;
  for (;;) {
    const ssize_t count = ::recv(fd, buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (count > 0) {
      bytes_.append(buffer.data(), static_cast<std::size_t>(count));
      if (bytes_.size() > kHeadBytes + kBodyBytesMax) return true;
      if (static_cast<std::size_t>(count) < buffer.size()) return true;  // That was all; the end of the stream is seen by the next poll.
      continue;
    }
    if (count < 0 && errno == EINTR) continue;
    return count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK);
  }
}

Result<std::optional<ComputeFrame>> ComputeFrameReader::Next() {
  if (bytes_.size() < kHeadBytes) return std::optional<ComputeFrame>();
  std::uint32_t size = 0;
  for (std::size_t i = 0; i < 4; ++i) size |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes_[1 + i])) << (8 * i);
  if (!IsKind(bytes_[0]) || size > kBodyBytesMax) return Corrupt("the compute process sent what is no message");
  if (bytes_.size() < kHeadBytes + size) return std::optional<ComputeFrame>();
  ComputeFrame frame{static_cast<ComputeFrameKind>(bytes_[0]), bytes_.substr(kHeadBytes, size)};
  bytes_.erase(0, kHeadBytes + size);
  return std::optional<ComputeFrame>(std::move(frame));
}

void ServeCompute(int fd, const TaskFunction& task) {
  Listener listener(fd);
  for (;;) {
    const v1::TaskSpec spec = listener.AwaitTask();
    Clock::time_point next_report{};
    const auto progress = [&](double fraction) {
      if (const auto now = Clock::now(); now >= next_report && fraction >= 0.0) {
        next_report = now + kProgressInterval;
        if (!SendComputeFrame(fd, ComputeFrameKind::kProgress, fmt::format("{}", fraction)).ok()) ::_exit(0);
      }
      return !listener.is_cancelled();
    };
    const TaskOutcome outcome = task(spec, progress);
    v1::Done done;
    done.set_peak_memory_bytes(OwnPeakMemoryBytes());
    if (outcome.result.ok()) {
      *done.mutable_result() = *outcome.result;
    } else {
      done.set_status_code(static_cast<std::uint32_t>(outcome.result.status().code()));
      done.set_message(outcome.result.status().message());
    }
    for (const std::string& digest : outcome.bad_artefacts) done.add_bad_artefacts(digest);
    // Messages may quote bytes that are no text; protobuf sends them all the same and the parent mends them.
    if (!SendComputeFrame(fd, ComputeFrameKind::kDone, done.SerializeAsString()).ok()) ::_exit(0);
  }
}

}  // namespace trem
