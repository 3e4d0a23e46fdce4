#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

struct SweepOptions {
  // Objects that nobody has used yet may belong to a task that is not committed or to a sortie that is still being uploaded: they stay so
  // long after they were put.
  std::chrono::seconds new_objects_stay{86'400};
  // Of what a removed job has left; somebody may just have put the same.
  std::chrono::seconds released_objects_stay{60};
};

struct SweepReport {
  std::uint64_t bytes = 0;  // Of what is left.
  std::uint64_t removed_objects = 0;
  std::uint64_t removed_bytes = 0;
};

// Which objects of an artefact store go: those that no job has and that are old enough.
class SweepRule {
 public:
  // Digests in any order, repeats allowed. `released`: what was in use when a job was removed.
  SweepRule(std::vector<std::string> in_use, std::vector<std::string> released, const SweepOptions& options);
  // `age`: since it was put; of a store whose clock is another it may be negative.
  bool MayGo(const std::string& digest, std::chrono::seconds age) const;

 private:
  std::vector<std::string> in_use_;    // Sorted.
  std::vector<std::string> released_;  // Sorted.
  SweepOptions options_;
};

// Digests (64 hexadecimal digits each) as 32 bytes each, one after the other, and back. kCorrupt when the bytes are no multiple of 32.
std::string PackDigests(const std::vector<std::string>& digests);
Result<std::vector<std::string>> UnpackDigests(std::string_view bytes);

}  // namespace trem
