#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>

#include "coordinator/store/event_store.h"
#include "coordinator/store/folder_lock.h"
#include "coordinator/store/sqlite.h"
#include "mosaic/base/digest.h"

namespace trem {

// 1: events. 2: a snapshot before them. 3: a snapshot that is written bit by bit, and which rows count.
constexpr int kStoreSchemaVersion = 3;
constexpr int kStoreApplicationId = 0x7472656d;  // "trem" in PRAGMA application_id: tells our database from other programs'.

// Rows that count: events from `events_begin` on, and of the snapshot those in [snapshot_begin, snapshot_end). Others are remains of what
// was there before, or the beginning of a snapshot that was never finished. The table log_state holds this in its one row.
struct LogRows {
  std::int64_t snapshot_begin = 1;
  std::int64_t snapshot_end = 1;
  std::int64_t events_begin = 1;
};

// A snapshot on its way into the database.
struct Compaction {
  EventStore::EventSource next;
  std::int64_t first_position = 1;
  std::int64_t next_position = 1;
  std::int64_t events_begin = 1;  // Once it is finished.
};

// A copy on its way to `path`, under another name until it is whole.
struct BackupJob {
  std::filesystem::path path;
  std::filesystem::path partial_path;
  sqlite::Database target;
  sqlite3_backup* copy = nullptr;  // Null: all pages are copied, the digest is being made.
  int fd = -1;
  Sha256 digest;
  std::uint64_t digested_bytes = 0;
  double fraction = 0.0;

  BackupJob() = default;
  BackupJob(const BackupJob&) = delete;
  BackupJob& operator=(const BackupJob&) = delete;
  ~BackupJob();
};

struct EventStore::State {
  std::filesystem::path path;
  std::unique_ptr<FolderLock> lock;
  sqlite::Database database;
  sqlite::Statement begin;
  sqlite::Statement insert;
  sqlite::Statement insert_snapshot;
  sqlite::Statement commit;
  sqlite::Statement rollback;
  LogRows rows;
  std::int64_t next_sequence = 1;
  // There may be rows that do not count, or pages to give back.
  bool has_remains = true;
  std::optional<Compaction> compaction;
  std::unique_ptr<BackupJob> backup;
  BackupProgress last_backup;

  // Steps a statement that gives no rows, and makes it ready for the next time.
  Status Execute(const sqlite::Statement& statement);
  // Inserts an event as row `number` of the statement's table.
  Status Insert(const sqlite::Statement& statement, std::int64_t number, const v1::LogEvent& event);
  // Runs `change` in a transaction of its own: all or nothing. Not `durable`: it may be lost with the power, wholly, until the next one
  // that is.
  Status Transact(bool durable, const std::function<Status()>& change);
  Status SaveRows(const LogRows& changed);

  // A bounded piece of each. True: there is more.
  Result<bool> StepCompaction();
  Result<bool> StepRemains();
  Result<bool> StepBackup();
  Result<bool> CopyPages();
  Result<bool> FinishBackup();
};

}  // namespace trem
