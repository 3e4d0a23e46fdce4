#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/channel/artefact_channel.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/app/input_files.h"

namespace trem {

struct TaskStoreOptions {
  std::string store;                  // A folder that is shared with the coordinator, or /vsis3/... Empty: artefacts are streamed.
  std::filesystem::path cache;        // Where artefacts are kept that are not in a folder; then not empty.
  std::uint64_t cache_bytes_max = 0;  // Of streamed artefacts that are kept between tasks.
  std::string coordinator;            // Endpoint.
  std::filesystem::path scratch;      // A folder that nobody else uses meanwhile, for the files of sorties; on the cache's or store's disk.
};

// Runs tasks on the artefact store that this worker was given: a shared folder, or a cache before an object store or the coordinator's data
// lane. Enters a folder of its own (see InputFiles): paths have to be absolute before.
class TaskStore {
 public:
  static Result<TaskStore> Open(const TaskStoreOptions& options, const ChannelOptions& channel_options);

  // RunTask on the store. `progress` is called during transfers too, so that they keep the lease; false stops them.
  Result<v1::TaskResult> Run(const v1::TaskSpec& spec, const std::function<bool(double)>& progress);
  const ArtefactStore& store() const { return *store_; }

 private:
  TaskStore() = default;
  Result<v1::TaskResult> RunHere(const v1::TaskSpec& spec, const std::function<bool(double)>& progress);

  TaskStoreOptions options_;
  std::shared_ptr<ArtefactChannel> channel_;  // Also the store's backing; null: nothing is streamed.
  std::optional<ArtefactStore> store_;
  std::optional<InputFiles> inputs_;
};

}  // namespace trem
