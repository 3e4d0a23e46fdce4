#pragma once

#include <functional>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What a task may use besides its spec.
struct TaskContext {
  const ArtefactStore* store = nullptr;  // Inputs are read from and outputs put into it.
  // Called often (at least once a second of work) with the fraction done, 0..1; renews the lease. False: stop soon and return
  // Cancelled.
  std::function<bool(double fraction)> progress;
  // That may be used, as far as ThreadsMax() allows at the time; the result does not depend on it.
  int threads = 1;
};

// Every task is a pure function of its spec and input artefacts: the same key gives the same output bytes.
Result<v1::TaskResult> RunIngestTask(const v1::TaskSpec& spec, const TaskContext& context);
Result<v1::TaskResult> RunEnhanceTask(const v1::TaskSpec& spec, const TaskContext& context);
Result<v1::TaskResult> RunAlignTask(const v1::TaskSpec& spec, const TaskContext& context);
Result<v1::TaskResult> RunCompositeTask(const v1::TaskSpec& spec, const TaskContext& context);
Result<v1::TaskResult> RunExportTask(const v1::TaskSpec& spec, const TaskContext& context);

// Dispatches on spec.kind(). Catches what a library throws (cv::Exception, std::bad_alloc -> kExhausted, std::exception -> kFailed).
Result<v1::TaskResult> RunTask(const v1::TaskSpec& spec, const TaskContext& context);

}  // namespace trem
