#include "worker/app/task_store.h"

#include <chrono>
#include <system_error>

#include "mosaic/base/parallel.h"
#include "mosaic/raster/vsi_backing.h"
#include "worker/tasks/task.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

// Longer than a task of another worker needs from looking for an input to having read it.
constexpr std::chrono::minutes kSparedFromTrim{10};

}  // namespace

Result<TaskStore> TaskStore::Open(const TaskStoreOptions& options, const ChannelOptions& channel_options) {
  TaskStore store;
  store.options_ = options;
  if (!options.store.empty() && !IsVsiPath(options.store)) {
    TREM_ASSIGN_OR_RETURN(store.store_, ArtefactStore::Open(fs::absolute(options.store).lexically_normal()));
  } else {
    std::shared_ptr<ArtefactBacking> backing = std::make_shared<VsiBacking>(options.store);
    if (options.store.empty()) backing = store.channel_ = std::make_shared<ArtefactChannel>(options.coordinator, channel_options);
    TREM_ASSIGN_OR_RETURN(store.store_, ArtefactStore::OpenCache(fs::absolute(options.cache).lexically_normal(), backing));
  }
  // What an earlier process has left there, killed perhaps while it wrote, is not used.
  const fs::path inputs = fs::absolute(options.scratch) / "inputs";
  std::error_code ignored;
  fs::remove_all(inputs, ignored);
  TREM_ASSIGN_OR_RETURN(store.inputs_, InputFiles::Open(inputs));
  return store;
}

Result<v1::TaskResult> TaskStore::Run(const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
  const bool is_cache = channel_ || IsVsiPath(options_.store);
  if (is_cache) TREM_RETURN_IF_ERROR(store_->Trim(options_.cache_bytes_max, kSparedFromTrim));
  double fraction = 0.0;
  const auto remember = [&](double now) {
    fraction = now;
    return progress(now);
  };
  if (channel_) channel_->set_on_chunk([&] { return progress(fraction); });
  Result<v1::TaskResult> result = RunHere(spec, remember);
  if (channel_) channel_->set_on_chunk({});
  return result;
}

Result<v1::TaskResult> TaskStore::RunHere(const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
  v1::TaskSpec here = spec;
  TREM_ASSIGN_OR_RETURN(*here.mutable_sortie(), inputs_->Bring(spec.sortie(), *store_));
  // As many as there may ever be: how many of them compute is told while the task runs.
  return RunTask(here, TaskContext{&*store_, progress, ProcessorCount()});
}

}  // namespace trem
