// The part of Shell that serves operators: logs of jobs, backups, how the service does.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <system_error>
#include <utility>

#include "coordinator/app/shell.h"
#include "mosaic/base/log.h"
#include "mosaic/base/sweep.h"
#include "mosaic/base/version.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_paths.h"
#include "proto/codec/upload.h"

namespace trem {
namespace {

constexpr TimeMs kRefusalsKeptMs = 600'000;
constexpr std::size_t kRefusalsKeptMax = 16;

// On the disk that holds `folder`; 0 when it cannot be asked.
std::uint64_t BytesFree(const std::filesystem::path& folder) {
  std::error_code error;
  const std::filesystem::space_info space = std::filesystem::space(folder, error);
  return error ? 0 : space.available;
}

}  // namespace

void Shell::NoteJob(const std::string& job_id, v1::LogLine line) {
  if (!job_log_) return;
  if (options_.wall_clock_ms) line.set_time_ms(options_.wall_clock_ms());
  job_log_->Append(job_id, std::move(line));
}

void Shell::NoteTask(const std::string& task_key, std::uint32_t attempt, const std::string& worker_id, const std::string& text,
                     bool is_warning) {
  if (!job_log_) return;
  for (const Scheduler::TaskUse& use : scheduler_.UsesOf(task_key)) {
    v1::LogLine line;
    line.set_task(use.title);
    line.set_task_key(task_key);
    line.set_attempt(attempt);
    line.set_worker_id(worker_id);
    line.set_text(text);
    line.set_warning(is_warning);
    NoteJob(use.job_id, std::move(line));
  }
}

// A failure is told by what the scheduler makes of it.
void Shell::NoteDone(const std::string& worker_id, const v1::Done& done) {
  if (!job_log_ || done.status_code() != 0) return;
  const v1::TaskAttempt& attempt = done.attempt();
  NoteTask(attempt.task_key(), attempt.attempt(), worker_id,
           fmt::format("result after {:.3f} s, at most {} MiB of memory", static_cast<double>(done.elapsed_ms()) / 1000.0,
                       done.peak_memory_bytes() >> 20));
  for (const v1::Note& note : done.result().notes()) {
    NoteTask(attempt.task_key(), attempt.attempt(), worker_id, NoteText(note), note.severity() == v1::WARNING);
  }
}

void Shell::OnTaskLog(const std::string& worker_id, const v1::TaskLog& log) {
  for (const std::string& text : log.lines()) NoteTask(log.attempt().task_key(), log.attempt().attempt(), worker_id, "stderr: " + text);
}

void Shell::OnGetLog(const std::string& peer, const v1::GetLog& get) {
  if (!job_log_) return Refuse(peer, InvalidInput("this coordinator keeps no logs of jobs"));
  if (scheduler_.FindSortie(get.job_id()) == nullptr) {
    return Refuse(peer, NotFound("there is no job '" + get.job_id() + "'; `trem list` shows all"));
  }
  v1::Envelope reply;
  *reply.mutable_log_page() = job_log_->Page(get);
  SendTo(peer, std::move(reply));
}

void Shell::OnBackup(const std::string& peer, const v1::Backup& backup) {
  if (options_.backup_folder.empty()) return Refuse(peer, InvalidInput("this coordinator makes no backups"));
  const Result<EventStore::BackupProgress> progress = events_->Backup(options_.backup_folder / (backup.backup_id() + ".sqlite"));
  if (!progress.ok()) return Refuse(peer, progress.status());
  v1::Envelope reply;
  v1::BackupStatus* status = reply.mutable_backup_status();
  status->set_backup_id(backup.backup_id());
  status->set_fraction(progress->fraction);
  status->set_path(progress->path.string());
  status->set_bytes(progress->bytes);
  status->set_sha256(progress->sha256);
  SendTo(peer, std::move(reply));
}

void Shell::NoteRefused(TimeMs now_ms, const v1::Hello& hello, const std::string& reason) {
  std::erase_if(refused_, [&](const auto& entry) { return now_ms - entry.second.at_ms > kRefusalsKeptMs; });
  if (refused_.size() >= kRefusalsKeptMax && refused_.count(hello.host()) == 0) {
    refused_.erase(
        std::min_element(refused_.begin(), refused_.end(), [](const auto& a, const auto& b) { return a.second.at_ms < b.second.at_ms; }));
  }
  Refused& refused = refused_[hello.host()];
  refused.worker.set_worker_id(hello.worker_id());
  refused.worker.set_host(hello.host());
  refused.worker.set_reason(reason);
  refused.at_ms = now_ms;
}

void Shell::OnGetServiceReport(TimeMs now_ms, const std::string& peer, const v1::GetServiceReport& get) {
  v1::Envelope reply;
  v1::ServiceReport* report = reply.mutable_service_report();
  report->set_version(TREM_VERSION);
  report->set_engine_revision(kEngineRevision);
  if (options_.wall_clock_ms) report->set_clock_ms(options_.wall_clock_ms());
  report->set_state_path(events_->path().parent_path().string());
  report->set_state_id(options_.state_id);
  report->set_state_bytes_free(BytesFree(events_->path().parent_path()));
  report->set_store_path(StorePath());
  if (options_.store_elsewhere.empty()) report->set_store_bytes_free(BytesFree(artefacts_.root()));
  report->set_store_bytes(store_bytes_);
  report->set_store_bytes_max(options_.store_bytes_max);
  report->set_refuses_jobs(no_jobs_because_);
  report->set_user_jobs(scheduler_.RunningJobCount(get.user()));
  report->set_user_jobs_max(options_.user_jobs_max);
  report->set_user_tasks_max(options_.scheduler.user_tasks_max);
  for (const auto& [host, refused] : refused_) {
    if (now_ms - refused.at_ms > kRefusalsKeptMs) continue;
    v1::RefusedWorker* worker = report->add_refused_workers();
    *worker = refused.worker;
    worker->set_ms_ago(static_cast<std::uint64_t>(now_ms - refused.at_ms));
  }
  SendTo(peer, std::move(reply));
}

// Every page costs a look at all tasks, which is why pages are large.
void Shell::OnListArtefacts(const std::string& peer, const v1::ListArtefacts& list) {
  constexpr std::size_t kPageMax = 400'000;
  Result<std::vector<std::string>> in_use = ArtefactsInUse();
  if (!in_use.ok()) return Refuse(peer, in_use.status());
  std::erase_if(*in_use, [&](const std::string& digest) { return digest <= list.after(); });
  std::sort(in_use->begin(), in_use->end());
  in_use->erase(std::unique(in_use->begin(), in_use->end()), in_use->end());
  v1::Envelope reply;
  reply.mutable_artefact_list()->set_is_last(in_use->size() <= kPageMax);
  in_use->resize(std::min(in_use->size(), kPageMax));
  reply.mutable_artefact_list()->set_digests(PackDigests(*in_use));
  SendTo(peer, std::move(reply));
}

bool Shell::Maintain() {
  if (is_full_) return false;
  const bool was_compacting = events_->is_compacting();
  const std::uint64_t before = events_->event_count() + events_->snapshot_count();
  const Result<bool> more = events_->Maintain();
  if (!more.ok()) {
    spdlog::warn("{}", more.status().message());
    if (was_compacting) options_.compact_after_events *= 2;  // Not at every message.
    return false;
  }
  if (was_compacting && !events_->is_compacting()) {
    spdlog::info("the log of {} events became a snapshot of {} and {} events", before, events_->snapshot_count(), events_->event_count());
  }
  return *more;
}

void Shell::OnRemoveJob(TimeMs now_ms, const std::string& peer, const v1::RemoveJob& remove) {
  const auto status = scheduler_.JobStatus(remove.job_id());
  if (!status.has_value()) return Refuse(peer, NotFound("there is no job '" + remove.job_id() + "'; `trem list` shows all"));
  if (status->state() == v1::JOB_RUNNING) {
    return Refuse(peer, InvalidInput("job '" + remove.job_id() + "' is running; cancel it first"));
  }
  if (options_.store_elsewhere.empty()) {
    Result<std::vector<std::string>> in_use = ArtefactsInUse();
    // When not all of it is known, what the job had goes with what nobody has claimed for a day.
    if (in_use.ok()) released_.insert(released_.end(), in_use->begin(), in_use->end());
  }
  Feed(now_ms, RemoveJobEvent{remove.job_id()});
  // The log would go on telling of artefacts that are no longer there.
  compact_next_ = true;
  v1::Envelope reply;
  reply.mutable_bye();
  SendTo(peer, std::move(reply));
}

Result<std::vector<std::string>> Shell::ArtefactsInUse() const {
  constexpr std::uint64_t kListBytesMax = std::uint64_t{256} << 20;
  std::vector<std::string> in_use;
  std::set<std::string> lists;
  Status failure;
  scheduler_.VisitInUse([&](const v1::ArtefactRef& artefact) { in_use.push_back(artefact.sha256()); },
                        [&](const v1::Sortie& sortie) {
                          v1::Sortie named = sortie;
                          for (const SortiePath& entry : PathsOf(&named)) {
                            const auto list = UploadOfPath(*entry.path);
                            if (!list || !lists.insert(list->sha256).second) continue;
                            in_use.push_back(list->sha256);
                            const auto bytes = artefacts_.ReadVerified(*list, kListBytesMax);
                            v1::UploadList files;
                            // One that is gone names nothing that anybody could read.
                            if (bytes.status().code() == StatusCode::kNotFound) continue;
                            if (!bytes.ok() || !files.ParseFromString(*bytes)) {
                              failure = Corrupt("the list of files of an upload, " + list->sha256 + ", cannot be read");
                              continue;
                            }
                            for (const v1::UploadedFile& file : files.files()) in_use.push_back(file.sha256());
                          }
                        });
  if (!failure.ok()) return failure;
  return in_use;
}

}  // namespace trem
