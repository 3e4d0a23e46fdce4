#include "coordinator/data/garbage_collector.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "mosaic/base/digest.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

void SortUnique(std::vector<std::string>* digests) {
  std::sort(digests->begin(), digests->end());
  digests->erase(std::unique(digests->begin(), digests->end()), digests->end());
}

// What processes that were killed have left half written. Folders belong to workers, which look after them themselves.
void SweepTemporaryFiles(const fs::path& folder, fs::file_time_type before) {
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;
    if (it->is_symlink(gone) || !it->is_regular_file(gone) || it->last_write_time(gone) >= before || gone) continue;
    fs::remove(it->path(), gone);
  }
}

}  // namespace

Result<SweepReport> SweepStore(const ArtefactStore& store, const SweepRule& rule, std::chrono::seconds temporary_files_stay,
                               const std::atomic<bool>& stop) {
  const auto now = fs::file_time_type::clock::now();
  SweepReport report;
  std::error_code error;
  for (fs::recursive_directory_iterator it(store.root() / "objects", error), end; !error && it != end; it.increment(error)) {
    if (stop) return Cancelled("stopped");
    std::error_code gone;
    const std::string digest = it->path().filename().string();
    if (it->is_symlink(gone) || !it->is_regular_file(gone) || !IsSha256Hex(digest)) continue;  // None of ours.
    const std::uint64_t bytes = it->file_size(gone);
    const auto put_at = it->last_write_time(gone);
    if (gone) continue;
    if (!rule.MayGo(digest, std::chrono::floor<std::chrono::seconds>(now - put_at)) || !fs::remove(it->path(), gone)) {
      report.bytes += bytes;
      continue;
    }
    ++report.removed_objects;
    report.removed_bytes += bytes;
  }
  if (error) return FromErrno("cannot list " + (store.root() / "objects").string(), error.value());
  SweepTemporaryFiles(store.root() / "tmp", now - temporary_files_stay);
  return report;
}

GarbageCollector::GarbageCollector(ArtefactStore store, const SweepOptions& options)
    : store_(std::move(store)), options_(options), thread_([this] { Run(); }) {}

GarbageCollector::~GarbageCollector() {
  {
    const std::lock_guard guard(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void GarbageCollector::Begin(std::vector<std::string> in_use, const std::vector<std::string>& released) {
  {
    const std::lock_guard guard(mutex_);
    wanted_ = std::move(in_use);
    released_.insert(released_.end(), released.begin(), released.end());
    SortUnique(&released_);
  }
  changed_.notify_all();
}

std::optional<SweepReport> GarbageCollector::TakeReport() {
  const std::lock_guard guard(mutex_);
  return std::exchange(report_, std::nullopt);
}

void GarbageCollector::Run() {
  for (;;) {
    std::vector<std::string> in_use, released;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return stop_ || wanted_.has_value(); });
      if (stop_) return;
      in_use = std::move(*wanted_);
      wanted_.reset();
      released = released_;
    }
    const Result<SweepReport> report =
        SweepStore(store_, SweepRule(std::move(in_use), std::move(released), options_), options_.new_objects_stay, stop_);
    if (!report.ok()) {
      if (!stop_) spdlog::warn("the artefact store was not swept: {}", report.status().message());
      continue;
    }
    if (report->removed_objects > 0) {
      spdlog::info("{} objects of {} bytes that no job has any more were removed from the artefact store; it holds {} bytes",
                   report->removed_objects, report->removed_bytes, report->bytes);
    }
    const std::lock_guard guard(mutex_);
    report_ = *report;
  }
}

}  // namespace trem
