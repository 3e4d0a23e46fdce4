// The part of EventStore that is done in pieces, between appends: compaction, clearing away, backups.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/store/event_store_state.h"
#include "mosaic/base/file.h"

namespace trem {

namespace fs = std::filesystem;
using sqlite::FromSqlite;
using sqlite::Run;
using sqlite::RunAll;

namespace {

// Pieces of a few milliseconds each: rows written or deleted, pages copied or given back, bytes digested.
constexpr std::int64_t kRowsAtOnce = 256;
constexpr int kPagesCopiedAtOnce = 256;
constexpr int kPagesFreedAtOnce = 256;
constexpr std::size_t kBytesDigestedAtOnce = std::size_t{2} << 20;
constexpr std::size_t kCompactedBytesAtOnce = std::size_t{512} << 10;

// For the path of a file: URI.
std::string PercentEncoded(const std::string& path) {
  std::string encoded;
  for (const char c : path) {
    const auto byte = static_cast<unsigned char>(c);
    if ((byte < 0x80 && std::isalnum(byte) != 0) || std::string_view("/-_.").find(c) != std::string_view::npos) {
      encoded += c;
    } else {
      constexpr char kDigits[] = "0123456789ABCDEF";
      encoded += {'%', kDigits[byte >> 4], kDigits[byte & 15]};
    }
  }
  return encoded;
}

Status SyncFolder(const fs::path& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return FromErrno("cannot open " + folder.string(), errno);
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  return result == 0 ? Status() : FromErrno("cannot sync " + folder.string(), error);
}

}  // namespace

BackupJob::~BackupJob() {
  if (copy != nullptr) sqlite3_backup_finish(copy);
  target.reset();
  if (fd >= 0) ::close(fd);
  std::error_code ignored;
  fs::remove(partial_path, ignored);
}

// ---- Compaction -----------------------------------------------------------------------------------------------------------------------

void EventStore::BeginCompaction(EventSource next) {
  State& state = *state_;
  if (state.compaction) return;
  // Behind remains of an earlier one that was not finished.
  const auto last = Run(state.database.get(), state.path, "SELECT max(position) FROM snapshot");
  const std::int64_t first = std::max(state.rows.snapshot_end, (last.ok() ? *last : 0) + 1);
  state.compaction = Compaction{std::move(next), first, first, state.next_sequence};
}

bool EventStore::is_compacting() const { return state_->compaction.has_value(); }

Status EventStore::Compact(std::span<const v1::LogEvent> snapshot) {
  State& state = *state_;
  std::size_t i = 0;
  state.compaction.reset();
  BeginCompaction([&]() -> std::optional<v1::LogEvent> { return i < snapshot.size() ? std::optional(snapshot[i++]) : std::nullopt; });
  for (;;) {
    TREM_ASSIGN_OR_RETURN(const bool more, Maintain());
    if (!more) return {};
  }
}

Status EventStore::State::SaveRows(const LogRows& changed) {
  const std::string sql = "UPDATE log_state SET snapshot_begin = " + std::to_string(changed.snapshot_begin) +
                          ", snapshot_end = " + std::to_string(changed.snapshot_end) +
                          ", events_begin = " + std::to_string(changed.events_begin);
  return RunAll(database.get(), path, {sql.c_str()});
}

Result<bool> EventStore::State::StepCompaction() {
  Compaction& work = *compaction;
  bool is_last = false;
  std::int64_t position = work.next_position;
  const Status written = Transact(false, [&]() -> Status {
    std::size_t bytes = 0;
    for (std::int64_t i = 0; i < kRowsAtOnce && bytes < kCompactedBytesAtOnce; ++i) {
      const std::optional<v1::LogEvent> event = work.next();
      is_last = !event.has_value();
      if (is_last) return {};
      TREM_RETURN_IF_ERROR(Insert(insert_snapshot, position++, *event));
      bytes += event->ByteSizeLong();
    }
    return {};
  });
  Status status = written;
  const LogRows changed{work.first_position, position, work.events_begin};
  if (status.ok() && is_last) status = Transact(true, [&] { return SaveRows(changed); });
  if (!status.ok()) {
    compaction.reset();
    has_remains = true;
    return status.WithPrefix("the log is not compacted");
  }
  work.next_position = position;
  if (!is_last) return true;
  rows = changed;
  compaction.reset();
  has_remains = true;
  return true;
}

// Rows that do not count any more, from their ends inwards; then pages that nothing uses.
Result<bool> EventStore::State::StepRemains() {
  sqlite3* raw = database.get();
  const std::string count = std::to_string(kRowsAtOnce);
  const std::string snapshot_begin = std::to_string(rows.snapshot_begin);
  const std::string snapshot_end = std::to_string(rows.snapshot_end);
  // One bound each: of two, SQLite would seek to one and look at every row for the other.
  const std::string deletes[] = {
      "DELETE FROM events WHERE sequence < min(" + std::to_string(rows.events_begin) + ", (SELECT min(sequence) FROM events) + " + count +
          ")",
      "DELETE FROM snapshot WHERE position < min(" + snapshot_begin + ", (SELECT min(position) FROM snapshot) + " + count + ")",
      "DELETE FROM snapshot WHERE position >= max(" + snapshot_end + ", (SELECT max(position) FROM snapshot) - " + count + " + 1)"};
  for (const std::string& sql : deletes) {
    TREM_RETURN_IF_ERROR(Transact(false, [&] { return RunAll(raw, path, {sql.c_str()}); }));
    if (sqlite3_changes(raw) > 0) return true;
  }
  TREM_ASSIGN_OR_RETURN(const std::int64_t free_pages, Run(raw, path, "PRAGMA freelist_count"));
  if (free_pages > 0) {
    const std::string vacuum = "PRAGMA incremental_vacuum(" + std::to_string(kPagesFreedAtOnce) + ")";
    TREM_RETURN_IF_ERROR(RunAll(raw, path, {vacuum.c_str()}));
    return true;
  }
  has_remains = false;
  TREM_RETURN_IF_ERROR(RunAll(raw, path, {"PRAGMA wal_checkpoint(TRUNCATE)"}));
  return false;
}

Result<bool> EventStore::Maintain() {
  State& state = *state_;
  bool more = false;
  if (state.compaction) {
    TREM_ASSIGN_OR_RETURN(more, state.StepCompaction());
  } else if (state.has_remains) {
    const Result<bool> remains = state.StepRemains();
    if (!remains.ok()) state.has_remains = false;  // Not at every turn: the next compaction clears them away.
    TREM_ASSIGN_OR_RETURN(more, remains);
  }
  if (!state.backup) return more;
  TREM_ASSIGN_OR_RETURN(const bool more_backup, state.StepBackup());
  return more || more_backup;
}

// ---- Backup ---------------------------------------------------------------------------------------------------------------------------

Result<EventStore::BackupProgress> EventStore::Backup(const fs::path& path) {
  State& state = *state_;
  if (state.last_backup.path == path && fs::exists(path)) return state.last_backup;
  if (state.backup && state.backup->path == path) return BackupProgress{state.backup->fraction, {}, 0, {}};
  if (state.backup) return Unavailable("backup " + state.backup->path.stem().string() + " is being made; ask again when it is done");
  auto job = std::make_unique<BackupJob>();
  job->path = path;
  std::error_code ignored;
  if (fs::exists(path, ignored)) {  // Made before this process started: only its digest is missing.
    job->fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (job->fd < 0) return FromErrno("cannot open " + path.string(), errno);
    state.backup = std::move(job);
    return BackupProgress{0.5, {}, 0, {}};
  }
  TREM_RETURN_IF_ERROR(MakeDirectories(path.parent_path()));
  job->partial_path = path.string() + ".partial";
  fs::remove(job->partial_path, ignored);
  const int fd = ::open(job->partial_path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0) return FromErrno("cannot make " + job->partial_path.string(), errno);
  job->fd = fd;
  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(job->partial_path.c_str(), &raw, SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOMUTEX, nullptr);
  job->target.reset(raw);
  if (opened != SQLITE_OK) return FromSqlite(raw, job->partial_path, "open");
  // Whatever breaks it off, half a copy is thrown away; it is made durable at the end.
  TREM_RETURN_IF_ERROR(
      RunAll(raw, job->partial_path, {"PRAGMA journal_mode = OFF", "PRAGMA synchronous = OFF", "PRAGMA locking_mode = EXCLUSIVE"}));
  job->copy = sqlite3_backup_init(raw, "main", state.database.get(), "main");
  if (job->copy == nullptr) return FromSqlite(raw, job->partial_path, "write");
  state.backup = std::move(job);
  return BackupProgress{};
}

Result<bool> EventStore::State::StepBackup() {
  Result<bool> more = backup->copy != nullptr ? CopyPages() : FinishBackup();
  if (more.ok()) return more;
  const Status status = more.status().WithPrefix("backup " + backup->path.string());
  backup.reset();
  return status;
}

// What is appended meanwhile through this same connection goes into the copy too.
Result<bool> EventStore::State::CopyPages() {
  BackupJob& job = *backup;
  const int code = sqlite3_backup_step(job.copy, kPagesCopiedAtOnce);
  const int pages = std::max(1, sqlite3_backup_pagecount(job.copy));
  job.fraction = 0.5 * (pages - sqlite3_backup_remaining(job.copy)) / pages;
  if (code == SQLITE_OK || code == SQLITE_BUSY || code == SQLITE_LOCKED) return true;
  const int finished = sqlite3_backup_finish(std::exchange(job.copy, nullptr));
  if (code != SQLITE_DONE || finished != SQLITE_OK) return FromSqlite(job.target.get(), job.partial_path, "write");
  job.target.reset();
  return true;
}

Result<bool> EventStore::State::FinishBackup() {
  BackupJob& job = *backup;
  std::string block(kBytesDigestedAtOnce, '\0');
  const ssize_t count = ::pread(job.fd, block.data(), block.size(), static_cast<off_t>(job.digested_bytes));
  if (count < 0) return FromErrno("cannot read it back", errno);
  if (count > 0) {
    struct stat info {};
    (void)::fstat(job.fd, &info);
    job.digest.Update(std::string_view(block).substr(0, static_cast<std::size_t>(count)));
    job.digested_bytes += static_cast<std::uint64_t>(count);
    job.fraction = 0.5 + 0.49 * static_cast<double>(job.digested_bytes) / static_cast<double>(std::max<off_t>(1, info.st_size));
    if (::fdatasync(job.fd) != 0 && errno != EINVAL && errno != EROFS) return FromErrno("cannot make it durable", errno);
    return true;
  }
  if (!job.partial_path.empty()) {
    if (::rename(job.partial_path.c_str(), job.path.c_str()) != 0) return FromErrno("cannot rename " + job.partial_path.string(), errno);
    TREM_RETURN_IF_ERROR(SyncFolder(job.path.parent_path()));
  }
  last_backup = {1.0, job.path, job.digested_bytes, job.digest.FinishHex()};
  backup.reset();
  return false;
}

Result<fs::path> EventStore::Restore(const fs::path& backup, const fs::path& folder) {
  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(("file:" + PercentEncoded(backup.string()) + "?immutable=1").c_str(), &raw,
                                     SQLITE_OPEN_READONLY | SQLITE_OPEN_URI | SQLITE_OPEN_NOMUTEX, nullptr);
  sqlite::Database database(raw);
  if (opened != SQLITE_OK) return FromSqlite(raw, backup, "open");
  TREM_ASSIGN_OR_RETURN(const std::int64_t application_id, Run(raw, backup, "PRAGMA application_id"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t version, Run(raw, backup, "PRAGMA user_version"));
  if (application_id != kStoreApplicationId || version < 1 || version > kStoreSchemaVersion) {
    return InvalidInput(backup.string() + " is no log of a coordinator, or one of a newer version");
  }
  TREM_ASSIGN_OR_RETURN(const std::int64_t faults,
                        Run(raw, backup, "SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'"));
  if (faults != 0) return Corrupt(backup.string() + " is damaged; use another backup");
  database.reset();

  TREM_RETURN_IF_ERROR(MakeDirectories(folder));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FolderLock> lock, FolderLock::Acquire(folder));
  const fs::path log = folder / "events.sqlite";
  const fs::path incoming = folder / "events.sqlite.incoming";
  TREM_RETURN_IF_ERROR(CopyFileAtomically(backup, incoming));
  (void)::chmod(incoming.c_str(), 0600);
  fs::path kept;
  std::error_code error;
  if (fs::exists(log, error)) {
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(std::chrono::system_clock::now().time_since_epoch()).count();
    kept = folder / ("replaced-" + std::to_string(seconds));
    TREM_RETURN_IF_ERROR(MakeDirectories(kept));
    // The log with what belongs to it: a -wal file of another time would damage the restored one.
    for (const char* suffix : {"-wal", "-shm", ""}) {
      const fs::path from = log.string() + suffix;
      if (!fs::exists(from, error)) continue;
      if (::rename(from.c_str(), (kept / from.filename()).c_str()) != 0) return FromErrno("cannot move " + from.string() + " away", errno);
    }
  }
  if (::rename(incoming.c_str(), log.c_str()) != 0) return FromErrno("cannot rename " + incoming.string(), errno);
  TREM_RETURN_IF_ERROR(SyncFolder(folder));
  return kept;
}

}  // namespace trem
