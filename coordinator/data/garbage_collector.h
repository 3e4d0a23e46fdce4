#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/base/sweep.h"

namespace trem {

// Removes the objects of `store` that may go by `rule`, and from its folder of temporary files those that are older than
// `temporary_files_stay`. Ends early, without harm, when `stop` is set.
Result<SweepReport> SweepStore(const ArtefactStore& store, const SweepRule& rule, std::chrono::seconds temporary_files_stay,
                               const std::atomic<bool>& stop);

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
