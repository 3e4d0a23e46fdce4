#include <fmt/format.h>

#include <exception>
#include <mutex>
#include <new>
#include <opencv2/core.hpp>

#include "worker/tasks/task.h"

namespace trem {
namespace {

Result<v1::TaskResult> Dispatch(const v1::TaskSpec& spec, const TaskContext& context) {
  switch (spec.kind()) {
    case v1::INGEST:
      return RunIngestTask(spec, context);
    case v1::ENHANCE:
      return RunEnhanceTask(spec, context);
    case v1::ALIGN:
      return RunAlignTask(spec, context);
    case v1::COMPOSITE:
      return RunCompositeTask(spec, context);
    case v1::EXPORT:
      return RunExportTask(spec, context);
    default:
      return InvalidInput(fmt::format("task {} has the kind {}; expected INGEST, ENHANCE, ALIGN, COMPOSITE or EXPORT", spec.key(),
                                      static_cast<int>(spec.kind())));
  }
}

}  // namespace

Result<v1::TaskResult> RunTask(const v1::TaskSpec& spec, const TaskContext& context) {
  TREM_CHECK(context.store != nullptr && context.progress != nullptr);
  // OpenCV's own threads would be more than this task may use.
  cv::setNumThreads(1);
  const auto where = [&spec] { return v1::TaskKind_Name(spec.kind()) + " task"; };
  // A task's threads report one at a time.
  std::mutex mutex;
  TaskContext guarded = context;
  guarded.progress = [&](double fraction) {
    const std::lock_guard lock(mutex);
    return context.progress(fraction);
  };
  try {
    return Dispatch(spec, guarded);
  } catch (const cv::Exception& error) {
    if (error.code == cv::Error::StsNoMem) return Exhausted(where() + ": OpenCV ran out of memory: " + error.what());
    return Failed(where() + ": OpenCV: " + error.what());
  } catch (const std::bad_alloc&) {
    return Exhausted(where() + ": out of memory; give the worker more memory, or use smaller windows (windows.roi_px, windows.frames)");
  } catch (const std::exception& error) {
    return Failed(where() + ": " + error.what());
  }
}

}  // namespace trem
