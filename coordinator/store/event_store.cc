#include "coordinator/store/event_store.h"

#include <sqlite3.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include "coordinator/store/folder_lock.h"
#include "coordinator/store/log_record.h"
#include "mosaic/base/file.h"

namespace trem {
namespace {

// 1: events. 2: a snapshot before them.
constexpr int kSchemaVersion = 2;
constexpr int kApplicationId = 0x7472656d;  // "trem" in PRAGMA application_id: tells our database from other programs'.

struct DatabaseCloser {
  void operator()(sqlite3* database) const { sqlite3_close(database); }
};
struct StatementFinalizer {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Database = std::unique_ptr<sqlite3, DatabaseCloser>;
using Statement = std::unique_ptr<sqlite3_stmt, StatementFinalizer>;

// What SQLite says, as a Status that names the file.
Status FromSqlite(sqlite3* database, const std::filesystem::path& path, const std::string& what) {
  const int code = sqlite3_extended_errcode(database);
  const int system_error = sqlite3_system_errno(database);
  const std::string text = "cannot " + what + " " + path.string() + ": " + sqlite3_errmsg(database);
  switch (code & 0xff) {
    case SQLITE_FULL:
      return Exhausted(text + "; make room on its disk and start again, nothing that was acknowledged is lost");
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return Unavailable(text + "; another program has it open");
    case SQLITE_CORRUPT:
      return Corrupt(text + "; restore it from a copy or choose another --state folder");
    case SQLITE_NOTADB:
      return Corrupt(text + "; move the file away or choose another --state folder");
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_CANTOPEN:
      return InvalidInput(text + "; check its permissions");
    default:
      if (system_error == ENOSPC || system_error == EDQUOT || system_error == EFBIG) {
        return Exhausted(text + " (" + std::strerror(system_error) + "); make room on its disk and start again");
      }
      return Failed(text);
  }
}

Result<Statement> Prepare(sqlite3* database, const std::filesystem::path& path, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK) return FromSqlite(database, path, "read");
  return Statement(statement);
}

// Runs a statement to its end and returns the first column of its first row, 0 without rows.
Result<std::int64_t> Run(sqlite3* database, const std::filesystem::path& path, const char* sql) {
  TREM_ASSIGN_OR_RETURN(const Statement statement, Prepare(database, path, sql));
  std::int64_t value = 0;
  bool first = true;
  int code = SQLITE_ROW;
  while ((code = sqlite3_step(statement.get())) == SQLITE_ROW) {
    if (first) value = sqlite3_column_int64(statement.get(), 0);
    first = false;
  }
  if (code != SQLITE_DONE) return FromSqlite(database, path, "use");
  return value;
}

Status RunAll(sqlite3* database, const std::filesystem::path& path, std::initializer_list<const char*> statements) {
  for (const char* sql : statements) {
    if (const auto result = Run(database, path, sql); !result.ok()) return result.status();
  }
  return {};
}

constexpr const char* kCreateEvents = "CREATE TABLE events (sequence INTEGER PRIMARY KEY, kind TEXT NOT NULL, body BLOB NOT NULL) STRICT";
constexpr const char* kCreateSnapshot =
    "CREATE TABLE snapshot (position INTEGER PRIMARY KEY, kind TEXT NOT NULL, body BLOB NOT NULL) STRICT";

// A new database gets its schema in one transaction; an older one what it lacks; a newer one is refused.
Status PrepareSchema(sqlite3* database, const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const std::int64_t application_id, Run(database, path, "PRAGMA application_id"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t version, Run(database, path, "PRAGMA user_version"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t tables, Run(database, path, "SELECT count(*) FROM sqlite_master"));
  if (application_id == kApplicationId && version == kSchemaVersion) return {};
  const std::string set_version = "PRAGMA user_version = " + std::to_string(kSchemaVersion);
  if (application_id == kApplicationId && version == 1) {
    return RunAll(database, path, {"BEGIN IMMEDIATE", kCreateSnapshot, set_version.c_str(), "COMMIT"});
  }
  if (application_id == kApplicationId) {
    return InvalidInput(path.string() + " has schema version " + std::to_string(version) + "; this program reads versions up to " +
                        std::to_string(kSchemaVersion) + ": use the trem-coordinator that wrote it or choose another --state folder");
  }
  if (application_id != 0 || tables != 0) {
    return InvalidInput(path.string() + " is another program's database; choose another --state folder");
  }
  const std::string set_id = "PRAGMA application_id = " + std::to_string(kApplicationId);
  return RunAll(database, path, {"BEGIN IMMEDIATE", kCreateEvents, kCreateSnapshot, set_id.c_str(), set_version.c_str(), "COMMIT"});
}

}  // namespace

struct EventStore::State {
  std::filesystem::path path;
  std::unique_ptr<FolderLock> lock;
  Database database;
  Statement begin;
  Statement insert;
  Statement insert_snapshot;
  Statement commit;
  Statement rollback;
  std::uint64_t snapshot_count = 0;
  std::uint64_t event_count = 0;

  // Steps a statement that gives no rows, and makes it ready for the next time.
  Status Execute(const Statement& statement) {
    const int code = sqlite3_step(statement.get());
    const Status status = code == SQLITE_DONE ? Status() : FromSqlite(database.get(), path, "append to");
    sqlite3_reset(statement.get());
    return status;
  }

  Status Insert(const Statement& statement, std::span<const v1::LogEvent> events) {
    for (const v1::LogEvent& event : events) {
      const std::string kind = KindOfLogRecord(event);
      const std::string body = EncodeLogRecord(event);
      sqlite3_bind_text(statement.get(), 1, kind.data(), static_cast<int>(kind.size()), SQLITE_STATIC);
      sqlite3_bind_blob64(statement.get(), 2, body.data(), body.size(), SQLITE_STATIC);
      const Status status = Execute(statement);
      sqlite3_clear_bindings(statement.get());
      TREM_RETURN_IF_ERROR(status);
    }
    return {};
  }
};

EventStore::EventStore(std::unique_ptr<State> state) : state_(std::move(state)) {}
EventStore::~EventStore() = default;

const std::filesystem::path& EventStore::path() const { return state_->path; }

Result<std::unique_ptr<EventStore>> EventStore::Open(const std::filesystem::path& folder, const EventStoreOptions& options) {
  TREM_RETURN_IF_ERROR(MakeDirectories(folder));
  auto state = std::make_unique<State>();
  state->path = folder / "events.sqlite";
  TREM_ASSIGN_OR_RETURN(state->lock, FolderLock::Acquire(folder));

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
  TREM_ASSIGN_OR_RETURN(state->insert, Prepare(raw, state->path, "INSERT INTO events (kind, body) VALUES (?1, ?2)"));
  TREM_ASSIGN_OR_RETURN(state->commit, Prepare(raw, state->path, "COMMIT"));
  TREM_ASSIGN_OR_RETURN(state->insert_snapshot, Prepare(raw, state->path, "INSERT INTO snapshot (kind, body) VALUES (?1, ?2)"));
  TREM_ASSIGN_OR_RETURN(state->rollback, Prepare(raw, state->path, "ROLLBACK"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t snapshot_count, Run(raw, state->path, "SELECT count(*) FROM snapshot"));
  TREM_ASSIGN_OR_RETURN(const std::int64_t event_count, Run(raw, state->path, "SELECT count(*) FROM events"));
  state->snapshot_count = static_cast<std::uint64_t>(snapshot_count);
  state->event_count = static_cast<std::uint64_t>(event_count);
  std::unique_ptr<EventStore> store(new EventStore(std::move(state)));
  if (options.bytes_max != 0) TREM_RETURN_IF_ERROR(store->SetBytesMax(options.bytes_max));
  return store;
}

Status EventStore::Transact(const std::function<Status()>& change) {
  State& state = *state_;
  TREM_RETURN_IF_ERROR(state.Execute(state.begin));
  Status status = change();
  if (status.ok()) status = state.Execute(state.commit);
  // SQLite itself rolls back on some errors; then there is nothing left to do.
  if (!status.ok() && sqlite3_get_autocommit(state.database.get()) == 0) {
    if (const Status rolled_back = state.Execute(state.rollback); !rolled_back.ok()) return status.WithPrefix(rolled_back.message());
  }
  return status;
}

Status EventStore::Append(std::span<const v1::LogEvent> events) {
  if (events.empty()) return {};
  TREM_RETURN_IF_ERROR(Transact([&] { return state_->Insert(state_->insert, events); }));
  state_->event_count += events.size();
  return {};
}

Status EventStore::Compact(std::span<const v1::LogEvent> snapshot) {
  State& state = *state_;
  const Status compacted = Transact([&]() -> Status {
    TREM_RETURN_IF_ERROR(RunAll(state.database.get(), state.path, {"DELETE FROM snapshot", "DELETE FROM events"}));
    return state.Insert(state.insert_snapshot, snapshot);
  });
  TREM_RETURN_IF_ERROR(compacted);
  state.snapshot_count = snapshot.size();
  state.event_count = 0;
  // Gives the room back; when that fails the pages are used again all the same.
  (void)Run(state.database.get(), state.path, "PRAGMA incremental_vacuum");
  (void)Run(state.database.get(), state.path, "PRAGMA wal_checkpoint(TRUNCATE)");
  return {};
}

std::uint64_t EventStore::snapshot_count() const { return state_->snapshot_count; }
std::uint64_t EventStore::event_count() const { return state_->event_count; }

Status EventStore::SetBytesMax(std::uint64_t bytes_max) {
  sqlite3* database = state_->database.get();
  TREM_ASSIGN_OR_RETURN(const std::int64_t page_bytes, Run(database, state_->path, "PRAGMA page_size"));
  // SQLite's own limit when there is none.
  const std::uint64_t pages = bytes_max == 0 ? 4294967294U : bytes_max / static_cast<std::uint64_t>(page_bytes);
  return RunAll(database, state_->path, {("PRAGMA max_page_count = " + std::to_string(pages)).c_str()});
}

Status EventStore::Replay(const std::function<Status(std::int64_t, const v1::LogEvent&)>& visit) const {
  sqlite3* database = state_->database.get();
  for (const char* sql : {"SELECT 0, body FROM snapshot ORDER BY position", "SELECT sequence, body FROM events ORDER BY sequence"}) {
    TREM_ASSIGN_OR_RETURN(const Statement select, Prepare(database, state_->path, sql));
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
    }
    if (code != SQLITE_DONE) return FromSqlite(database, state_->path, "read");
  }
  return {};
}

}  // namespace trem
