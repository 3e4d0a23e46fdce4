#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "mosaic/base/artefact_store.h"
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

// Removes the objects of `store` that are not among `in_use`, and old files from its folder of temporary ones. `released`: what was in use
// at an earlier sweep. Both are sorted digests. Ends early, without harm, when `stop` is set.
Result<SweepReport> SweepStore(const ArtefactStore& store, const std::vector<std::string>& in_use, const std::vector<std::string>& released,
                               const SweepOptions& options, const std::atomic<bool>& stop);

// Sweeps a coordinator's store on a thread of its own, whenever it is told what is in use.
class GarbageCollector {
 public:
  GarbageCollector(ArtefactStore store, const SweepOptions& options);
  ~GarbageCollector();
  GarbageCollector(const GarbageCollector&) = delete;
  GarbageCollector& operator=(const GarbageCollector&) = delete;

  // Digests in any order, repeats allowed. `released`: what was in use when a job was removed since the last call. A sweep that has not
  // begun is replaced.
  void Begin(std::vector<std::string> in_use, const std::vector<std::string>& released);
  // What the last sweep that nobody has asked about has found.
  std::optional<SweepReport> TakeReport();

 private:
  void Run();

  ArtefactStore store_;
  SweepOptions options_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<std::vector<std::string>> wanted_;
  std::vector<std::string> released_;  // Sorted; of all calls. What is still in use does not matter.
  std::optional<SweepReport> report_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace trem
