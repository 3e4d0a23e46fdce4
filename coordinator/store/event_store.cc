#include "coordinator/store/event_store.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <string>
#include <utility>

#include "coordinator/store/event_store_state.h"
#include "coordinator/store/log_record.h"
#include "mosaic/base/file.h"

namespace trem {

using sqlite::FromSqlite;
using sqlite::Prepare;
using sqlite::Run;
using sqlite::RunAll;
using sqlite::Statement;

namespace {

constexpr const char* kCreateEvents = "CREATE TABLE events (sequence INTEGER PRIMARY KEY, kind TEXT NOT NULL, body BLOB NOT NULL) STRICT";
constexpr const char* kCreateSnapshot =
    "CREATE TABLE snapshot (position INTEGER PRIMARY KEY, kind TEXT NOT NULL, body BLOB NOT NULL) STRICT";

constexpr const char* kCreateLogState =
    "CREATE TABLE log_state (id INTEGER PRIMARY KEY CHECK (id = 1), snapshot_begin INTEGER NOT NULL, snapshot_end INTEGER NOT NULL, "
    "events_begin INTEGER NOT NULL) STRICT";
// Every row of an older version counts.
constexpr const char* kInsertLogState =
    "INSERT INTO log_state SELECT 1, coalesce(min(position), 1), coalesce(max(position), 0) + 1, "
    "(SELECT coalesce(min(sequence), 1) FROM events) FROM snapshot";

// A new database gets its schema in one transaction; an older one what it lacks; a newer one is refused.
Status PrepareSchema(sqlite3* database, const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const std::int64_t application_id, Run(database, path, "PRAGMA application_id"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t version, Run(database, path, "PRAGMA user_version"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t tables, Run(database, path, "SELECT count(*) FROM sqlite_master"));
  const std::string set_version = "PRAGMA user_version = " + std::to_string(kStoreSchemaVersion);
  if (application_id == kStoreApplicationId) {
    if (version == kStoreSchemaVersion) return {};
    if (version == 1) {
      return RunAll(database, path, {"BEGIN IMMEDIATE", kCreateSnapshot, kCreateLogState, kInsertLogState, set_version.c_str(), "COMMIT"});
    }
    if (version == 2) return RunAll(database, path, {"BEGIN IMMEDIATE", kCreateLogState, kInsertLogState, set_version.c_str(), "COMMIT"});
    return InvalidInput(path.string() + " has schema version " + std::to_string(version) + "; this program reads versions up to " +
                        std::to_string(kStoreSchemaVersion) + ": use the trem-coordinator that wrote it or choose another --state folder");
  }
  if (application_id != 0 || tables != 0) {
    return InvalidInput(path.string() + " is another program's database; choose another --state folder");
  }
  const std::string set_id = "PRAGMA application_id = " + std::to_string(kStoreApplicationId);
  return RunAll(
      database, path,
      {"BEGIN IMMEDIATE", kCreateEvents, kCreateSnapshot, kCreateLogState, kInsertLogState, set_id.c_str(), set_version.c_str(), "COMMIT"});
}

// The file, for nobody else to read; what SQLite puts beside it gets the same mode.
void MakePrivate(const std::filesystem::path& path) {
  if (const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600); fd >= 0) ::close(fd);
}

}  // namespace

Status EventStore::State::Execute(const Statement& statement) {
  const int code = sqlite3_step(statement.get());
  const Status status = code == SQLITE_DONE ? Status() : FromSqlite(database.get(), path, "append to");
  sqlite3_reset(statement.get());
  return status;
}

Status EventStore::State::Insert(const Statement& statement, std::int64_t number, const v1::LogEvent& event) {
  const std::string kind = KindOfLogRecord(event);
  const std::string body = EncodeLogRecord(event);
  sqlite3_bind_int64(statement.get(), 1, number);
  sqlite3_bind_text(statement.get(), 2, kind.data(), static_cast<int>(kind.size()), SQLITE_STATIC);
  sqlite3_bind_blob64(statement.get(), 3, body.data(), body.size(), SQLITE_STATIC);
  const Status status = Execute(statement);
  sqlite3_clear_bindings(statement.get());
  return status;
}

Status EventStore::State::Transact(bool durable, const std::function<Status()>& change) {
  sqlite3* raw = database.get();
  // Without an fsync of its own; the next durable transaction's covers it, and until then it is there as a whole or not at all.
  if (!durable) TREM_RETURN_IF_ERROR(RunAll(raw, path, {"PRAGMA synchronous = NORMAL"}));
  Status status = Execute(begin);
  if (status.ok()) {
    status = change();
    if (status.ok()) status = Execute(commit);
    // SQLite itself rolls back on some errors; then there is nothing left to do.
    if (!status.ok() && sqlite3_get_autocommit(raw) == 0) {
      if (const Status rolled_back = Execute(rollback); !rolled_back.ok()) status = status.WithPrefix(rolled_back.message());
    }
  }
  if (!durable) TREM_RETURN_IF_ERROR(RunAll(raw, path, {"PRAGMA synchronous = FULL"}));
  return status;
}

EventStore::EventStore(std::unique_ptr<State> state) : state_(std::move(state)) {}
EventStore::~EventStore() = default;

const std::filesystem::path& EventStore::path() const { return state_->path; }

Result<std::unique_ptr<EventStore>> EventStore::Open(const std::filesystem::path& folder, const EventStoreOptions& options) {
  TREM_RETURN_IF_ERROR(MakeDirectories(folder));
  auto state = std::make_unique<State>();
  state->path = folder / "events.sqlite";
  TREM_ASSIGN_OR_RETURN(state->lock, FolderLock::Acquire(folder));

  MakePrivate(state->path);
  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(state->path.c_str(), &raw, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, nullptr);
  state->database.reset(raw);
  if (opened != SQLITE_OK) return FromSqlite(raw, state->path, "open");
  // Exclusive locking needs no shared memory file, so the folder may lie on a network file system.
  TREM_RETURN_IF_ERROR(RunAll(raw, state->path,
                              {"PRAGMA auto_vacuum = INCREMENTAL", "PRAGMA locking_mode = EXCLUSIVE", "PRAGMA journal_mode = WAL",
                               "PRAGMA synchronous = FULL", "PRAGMA trusted_schema = OFF", "PRAGMA cell_size_check = ON"}));
  TREM_RETURN_IF_ERROR(PrepareSchema(raw, state->path));
  TREM_ASSIGN_OR_RETURN(state->begin, Prepare(raw, state->path, "BEGIN IMMEDIATE"));
  TREM_ASSIGN_OR_RETURN(state->insert, Prepare(raw, state->path, "INSERT INTO events VALUES (?1, ?2, ?3)"));
  TREM_ASSIGN_OR_RETURN(state->commit, Prepare(raw, state->path, "COMMIT"));
  TREM_ASSIGN_OR_RETURN(state->insert_snapshot, Prepare(raw, state->path, "INSERT INTO snapshot VALUES (?1, ?2, ?3)"));
  TREM_ASSIGN_OR_RETURN(state->rollback, Prepare(raw, state->path, "ROLLBACK"));
  TREM_ASSIGN_OR_RETURN(state->rows.snapshot_begin, Run(raw, state->path, "SELECT snapshot_begin FROM log_state"));
  TREM_ASSIGN_OR_RETURN(state->rows.snapshot_end, Run(raw, state->path, "SELECT snapshot_end FROM log_state"));
  TREM_ASSIGN_OR_RETURN(state->rows.events_begin, Run(raw, state->path, "SELECT events_begin FROM log_state"));
  if (state->rows.snapshot_begin < 1 || state->rows.snapshot_end < state->rows.snapshot_begin || state->rows.events_begin < 1) {
    return Corrupt(state->path.string() + " does not say which of its events count; restore it from a backup");
  }
  TREM_ASSIGN_OR_RETURN(const std::int64_t last_sequence, Run(raw, state->path, "SELECT max(sequence) FROM events"));
  state->next_sequence = std::max(last_sequence + 1, state->rows.events_begin);
  std::unique_ptr<EventStore> store(new EventStore(std::move(state)));
  if (options.bytes_max != 0) TREM_RETURN_IF_ERROR(store->SetBytesMax(options.bytes_max));
  return store;
}

Status EventStore::Append(std::span<const v1::LogEvent> events) {
  if (events.empty()) return {};
  State& state = *state_;
  const Status appended = state.Transact(true, [&]() -> Status {
    std::int64_t sequence = state.next_sequence;
    for (const v1::LogEvent& event : events) TREM_RETURN_IF_ERROR(state.Insert(state.insert, sequence++, event));
    return {};
  });
  TREM_RETURN_IF_ERROR(appended);
  state.next_sequence += static_cast<std::int64_t>(events.size());
  return {};
}

std::uint64_t EventStore::snapshot_count() const {
  return static_cast<std::uint64_t>(state_->rows.snapshot_end - state_->rows.snapshot_begin);
}
std::uint64_t EventStore::event_count() const { return static_cast<std::uint64_t>(state_->next_sequence - state_->rows.events_begin); }

Status EventStore::SetBytesMax(std::uint64_t bytes_max) {
  sqlite3* database = state_->database.get();
  TREM_ASSIGN_OR_RETURN(const std::int64_t page_bytes, Run(database, state_->path, "PRAGMA page_size"));
  // SQLite's own limit when there is none.
  const std::uint64_t pages = bytes_max == 0 ? 4294967294U : bytes_max / static_cast<std::uint64_t>(page_bytes);
  return RunAll(database, state_->path, {("PRAGMA max_page_count = " + std::to_string(pages)).c_str()});
}

Status EventStore::Replay(const std::function<Status(std::int64_t, const v1::LogEvent&)>& visit) const {
  sqlite3* database = state_->database.get();
  const LogRows& rows = state_->rows;
  const std::string snapshot = "SELECT 0, body FROM snapshot WHERE position >= " + std::to_string(rows.snapshot_begin) +
                               " AND position < " + std::to_string(rows.snapshot_end) + " ORDER BY position";
  const std::string events =
      "SELECT sequence, body FROM events WHERE sequence >= " + std::to_string(rows.events_begin) + " ORDER BY sequence";
  for (const auto& [sql, expected_count] : {std::pair(&snapshot, snapshot_count()), std::pair(&events, event_count())}) {
    TREM_ASSIGN_OR_RETURN(const Statement select, Prepare(database, state_->path, sql->c_str()));
    std::uint64_t count = 0;
    int code = SQLITE_ROW;
    while ((code = sqlite3_step(select.get())) == SQLITE_ROW) {
      const std::int64_t sequence = sqlite3_column_int64(select.get(), 0);
      const char* body = static_cast<const char*>(sqlite3_column_blob(select.get(), 1));
      const auto body_bytes = static_cast<std::size_t>(sqlite3_column_bytes(select.get(), 1));
      const Result<v1::LogEvent> event = DecodeLogRecord(std::string_view(body, body_bytes));
      if (!event.ok()) {
        const std::string which = sequence == 0 ? "an event of the snapshot" : "event " + std::to_string(sequence);
        return Corrupt(state_->path.string() + ": " + which + " cannot be read: " + event.status().message() +
                       "; restore the file from a copy");
      }
      TREM_RETURN_IF_ERROR(visit(sequence, *event));
      ++count;
    }
    if (code != SQLITE_DONE) return FromSqlite(database, state_->path, "read");
    if (count != expected_count) {
      return Corrupt(state_->path.string() + " has " + std::to_string(count) + " events where " + std::to_string(expected_count) +
                     " were written; restore it from a backup");
    }
  }
  return {};
}

}  // namespace trem
