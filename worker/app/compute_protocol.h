#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What a serving process and its compute process say to each other over a socket pair: frames of a kind (1 byte), a length (4 bytes, little
// endian) and as many bytes.
enum class ComputeFrameKind : char {
  kTask = 'T',      // To the child: a TaskSpec.
  kCancel = 'C',    // To the child: nothing.
  kShare = 'S',     // To the child: how many processors the running task may use, as decimal text. Each task begins with one.
  kProgress = 'P',  // To the parent: a fraction as decimal text.
  kDone = 'D',      // To the parent: a Done without its attempt.
};
struct ComputeFrame {
  ComputeFrameKind kind = ComputeFrameKind::kTask;
  std::string body;
};

// kUnavailable when the other side is gone.
Status SendComputeFrame(int fd, ComputeFrameKind kind, std::string_view body);

// Collects bytes into frames.
class ComputeFrameReader {
 public:
  // Reads what is there without waiting; false when the other side is gone.
  bool ReadAvailable(int fd);
  // The next whole frame. kCorrupt when the bytes are none.
  Result<std::optional<ComputeFrame>> Next();

 private:
  std::string bytes_;
};

// What an attempt came to.
struct TaskOutcome {
  TaskOutcome(Result<v1::TaskResult> r) : result(std::move(r)) {}              // NOLINT: implicit on purpose.
  TaskOutcome(Status status) : result(std::move(status)) {}                    // NOLINT: implicit on purpose.
  TaskOutcome(v1::TaskResult task_result) : result(std::move(task_result)) {}  // NOLINT: implicit on purpose.
  Result<v1::TaskResult> result;
  std::uint64_t peak_memory_bytes = 0;     // 0: not known.
  std::vector<std::string> bad_artefacts;  // Digests of inputs that are damaged or missing.
};

// What computes; must not throw. It calls `progress` often and returns soon after that said false. A negative fraction asks without
// reporting any progress.
using TaskFunction = std::function<TaskOutcome(const v1::TaskSpec& spec, const std::function<bool(double)>& progress)>;

// The child's life: computes what it is told to over `fd`, one task after the other; the process ends when the parent is gone.
[[noreturn]] void ServeCompute(int fd, const TaskFunction& task);

}  // namespace trem
