// Goal: what Append acknowledged survives, what it did not is absent as a whole, and no folder is opened twice or misread. Method: real
// SQLite files in a temporary folder; crashes are copies of the files taken while the log is open, with the write-ahead log cut at every
// few hundred bytes.
#include "coordinator/store/event_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "mosaic/base/digest.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using trem::testing::FileContents;
using trem::testing::TempDir;
using trem::testing::WriteFileContents;

v1::LogEvent MakeEvent(std::uint32_t number, std::size_t padding = 0) {
  v1::LogEvent event;
  event.mutable_attempt_started()->set_task_key(std::string(64, 'a'));
  event.mutable_attempt_started()->set_worker_id(std::string(padding, 'x'));
  event.mutable_attempt_started()->set_attempt(number);
  return event;
}

Result<std::vector<std::uint32_t>> ReadAll(const EventStore& store) {
  std::vector<std::uint32_t> numbers;
  std::int64_t expected = 1;
  TREM_RETURN_IF_ERROR(store.Replay([&](std::int64_t sequence, const v1::LogEvent& event) -> Status {
    if (sequence != expected++) return Failed("sequence " + std::to_string(sequence));
    numbers.push_back(event.attempt_started().attempt());
    return {};
  }));
  return numbers;
}

// Events of the snapshot and after it.
std::vector<std::uint32_t> Numbers(const EventStore& store) {
  std::vector<std::uint32_t> numbers;
  const Status status = store.Replay([&](std::int64_t, const v1::LogEvent& event) {
    numbers.push_back(event.attempt_started().attempt());
    return Status();
  });
  EXPECT_TRUE(status.ok()) << status.ToString();
  return numbers;
}

std::unique_ptr<EventStore> MustOpen(const fs::path& folder, const EventStoreOptions& options = {}) {
  auto store = EventStore::Open(folder, options);
  TREM_CHECK_MSG(store.ok(), store.status().ToString());
  return std::move(store).value();
}

void ExecuteSql(const fs::path& path, const std::string& sql) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  EXPECT_EQ(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
  sqlite3_close(database);
}

TEST(EventStoreTest, ReplaysWhatWasAppendedInOrderAfterReopening) {
  const TempDir folder;
  const fs::path state = folder / "deep" / "state";
  {
    const auto store = MustOpen(state);
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(1), MakeEvent(2)}).ok());
    ASSERT_TRUE(store->Append(std::vector<v1::LogEvent>{}).ok());
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(3)}).ok());
  }
  const auto store = MustOpen(state);
  EXPECT_EQ(ReadAll(*store).value(), (std::vector<std::uint32_t>{1, 2, 3}));
  ASSERT_TRUE(store->Append(std::vector{MakeEvent(4)}).ok());
  EXPECT_EQ(ReadAll(*store).value(), (std::vector<std::uint32_t>{1, 2, 3, 4}));
}

TEST(EventStoreTest, StopsReplayAtTheVisitorsError) {
  const TempDir folder;
  const auto store = MustOpen(folder.path());
  ASSERT_TRUE(store->Append(std::vector{MakeEvent(1), MakeEvent(2)}).ok());
  int visits = 0;
  const Status status = store->Replay([&](std::int64_t, const v1::LogEvent&) {
    ++visits;
    return Corrupt("no sense");
  });
  EXPECT_EQ(status.code(), StatusCode::kCorrupt);
  EXPECT_EQ(visits, 1);
}

TEST(EventStoreTest, KeepsAPrefixOfWholeAppendsWhenTheWriteAheadLogIsCutAnywhere) {
  const TempDir folder;
  const fs::path live = folder / "live";
  const auto store = MustOpen(live);
  // Appends of 1, 2, 3, ... events; the log may only ever end between two of them.
  std::set<std::size_t> whole_counts = {0};
  std::uint32_t next = 0;
  for (std::uint32_t size = 1; size <= 6; ++size) {
    std::vector<v1::LogEvent> events;
    for (std::uint32_t i = 0; i < size; ++i) events.push_back(MakeEvent(++next, 700));
    ASSERT_TRUE(store->Append(events).ok());
    whole_counts.insert(next);
  }
  const std::string database = FileContents(live / "events.sqlite");
  const std::string log = FileContents(live / "events.sqlite-wal");
  ASSERT_GT(log.size(), 20'000U);
  std::size_t count_before = 0;
  std::set<std::size_t> counts_seen;
  for (std::size_t bytes = 0;; bytes = std::min(bytes + 509, log.size())) {
    SCOPED_TRACE(::testing::Message() << "write-ahead log cut at " << bytes << " bytes");
    const fs::path copy = folder / ("copy" + std::to_string(bytes));
    fs::create_directories(copy);
    WriteFileContents(copy / "events.sqlite", database);
    WriteFileContents(copy / "events.sqlite-wal", log.substr(0, bytes));
    const auto reopened = MustOpen(copy);
    const auto numbers = ReadAll(*reopened);
    ASSERT_TRUE(numbers.ok()) << numbers.status().ToString();
    ASSERT_EQ(whole_counts.count(numbers->size()), 1U) << numbers->size() << " events are not a number of whole appends";
    for (std::size_t i = 0; i < numbers->size(); ++i) ASSERT_EQ((*numbers)[i], i + 1);
    ASSERT_GE(numbers->size(), count_before);
    count_before = numbers->size();
    counts_seen.insert(numbers->size());
    ASSERT_TRUE(reopened->Append(std::vector{MakeEvent(99)}).ok()) << "a recovered log must take more";
    fs::remove_all(copy);
    if (bytes == log.size()) break;
  }
  EXPECT_EQ(count_before, next) << "the whole write-ahead log holds everything acknowledged";
  EXPECT_EQ(counts_seen, whole_counts) << "the cuts missed some state between two appends";
}

TEST(EventStoreTest, SurvivesTheProcessThatWroteItBeingKilled) {
  const TempDir folder;
  std::array<int, 2> pipe_fds{};
  ASSERT_EQ(pipe(pipe_fds.data()), 0);
  const pid_t child = fork();
  if (child == 0) {
    const auto store = EventStore::Open(folder.path());
    const bool appended = store.ok() && (*store)->Append(std::vector{MakeEvent(1), MakeEvent(2)}).ok();
    const char byte = appended ? 'y' : 'n';
    [[maybe_unused]] const ssize_t written = write(pipe_fds[1], &byte, 1);
    pause();
    _exit(0);
  }
  char byte = 0;
  ASSERT_EQ(read(pipe_fds[0], &byte, 1), 1);
  EXPECT_EQ(byte, 'y');
  const auto second = EventStore::Open(folder.path());
  ASSERT_FALSE(second.ok());
  EXPECT_EQ(second.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(second.status().message(), HasSubstr("in use by process " + std::to_string(child)));
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  close(pipe_fds[0]);
  close(pipe_fds[1]);
  EXPECT_EQ(ReadAll(*MustOpen(folder.path())).value(), (std::vector<std::uint32_t>{1, 2}));
}

TEST(EventStoreTest, IsHeldByOneOwnerAtATime) {
  const TempDir folder;
  auto store = MustOpen(folder.path());
  EXPECT_EQ(EventStore::Open(folder.path()).status().code(), StatusCode::kUnavailable);
  store.reset();
  EXPECT_TRUE(EventStore::Open(folder.path()).ok());
}

TEST(EventStoreTest, RefusesANewerSchemaVersionByNumber) {
  const TempDir folder;
  MustOpen(folder.path());
  ExecuteSql(folder / "events.sqlite", "PRAGMA user_version = 7");
  const auto store = EventStore::Open(folder.path());
  ASSERT_FALSE(store.ok());
  EXPECT_EQ(store.status().code(), StatusCode::kInvalidInput);
  EXPECT_THAT(store.status().message(), HasSubstr("has schema version 7; this program reads versions up to 3"));
}

// What a program of schema version 1 left behind.
TEST(EventStoreTest, MigratesALogOfTheFirstSchemaVersion) {
  const TempDir folder;
  const fs::path path = folder / "events.sqlite";
  ASSERT_TRUE(MustOpen(folder.path())->Append(std::vector{MakeEvent(1), MakeEvent(2)}).ok());
  ExecuteSql(path, "DROP TABLE snapshot; DROP TABLE log_state; PRAGMA user_version = 1");
  const auto store = MustOpen(folder.path());
  EXPECT_EQ(ReadAll(*store).value(), (std::vector<std::uint32_t>{1, 2}));
  ASSERT_TRUE(store->Append(std::vector{MakeEvent(3)}).ok());
  EXPECT_EQ(store->event_count(), 3U);
  EXPECT_TRUE(store->Compact(std::vector{MakeEvent(9)}).ok());
}

TEST(EventStoreTest, MigratesALogOfTheSecondSchemaVersionWithItsSnapshot) {
  const TempDir folder;
  {
    const auto store = MustOpen(folder.path());
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(1)}).ok());
    ASSERT_TRUE(store->Compact(std::vector{MakeEvent(10), MakeEvent(11)}).ok());
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(2)}).ok());
  }
  ExecuteSql(folder / "events.sqlite", "DROP TABLE log_state; PRAGMA user_version = 2");
  const auto store = MustOpen(folder.path());
  EXPECT_EQ(store->snapshot_count(), 2U);
  EXPECT_EQ(Numbers(*store), (std::vector<std::uint32_t>{10, 11, 2}));
}

// Goal: a snapshot that is written bit by bit never shows: at every moment, and after a crash at every moment, the log is either the old
// one or the new, and holds what was appended meanwhile. Method: 2000 rows, an append after each piece, and after each piece a copy of the
// files that is opened as after a crash.
TEST(EventStoreTest, CompactsInPiecesBetweenAppendsAndThroughCrashes) {
  const TempDir folder;
  auto store = MustOpen(folder / "state");
  std::vector<std::uint32_t> before;
  for (std::uint32_t i = 0; i < 20; ++i) before.push_back(i);
  for (const std::uint32_t i : before) ASSERT_TRUE(store->Append(std::vector{MakeEvent(i, 300)}).ok());
  std::vector<std::uint32_t> after, appended;
  std::uint32_t next = 1000;
  store->BeginCompaction([&]() -> std::optional<v1::LogEvent> {
    if (next == 3000) return std::nullopt;
    after.push_back(next);
    return MakeEvent(next++, 100);
  });
  int pieces = 0;
  bool has_switched = false;
  for (bool more = true; more; ++pieces) {
    const auto result = store->Maintain();
    ASSERT_TRUE(result.ok()) << result.status().ToString();
    more = *result;
    has_switched |= !store->is_compacting();
    appended.push_back(static_cast<std::uint32_t>(100 + pieces));
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(appended.back())}).ok());
    std::vector<std::uint32_t> expected = has_switched ? after : before;
    expected.insert(expected.end(), appended.begin(), appended.end());
    EXPECT_EQ(Numbers(*store), expected) << "piece " << pieces;
    const fs::path crashed = folder / ("crashed-" + std::to_string(pieces));
    fs::create_directories(crashed);
    for (const char* name : {"events.sqlite", "events.sqlite-wal"}) {
      if (fs::exists(folder / "state" / name)) fs::copy_file(folder / "state" / name, crashed / name);
    }
    const auto reopened = MustOpen(crashed);
    EXPECT_EQ(Numbers(*reopened), expected) << "after a crash in piece " << pieces;
    // What was begun there does not stand in the way of the next one.
    ASSERT_TRUE(reopened->Compact(std::vector{MakeEvent(7)}).ok());
    ASSERT_TRUE(reopened->Append(std::vector{MakeEvent(8)}).ok());
    EXPECT_EQ(Numbers(*reopened), (std::vector<std::uint32_t>{7, 8}));
  }
  EXPECT_GT(pieces, 10);
  EXPECT_EQ(store->snapshot_count(), 2000U);
}

TEST(EventStoreTest, CopiesItselfWhileEventsAreAppended) {
  const TempDir folder;
  const auto store = MustOpen(folder / "state");
  std::vector<std::uint32_t> numbers;
  const auto append = [&] {
    numbers.push_back(static_cast<std::uint32_t>(numbers.size()));
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(numbers.back(), 4000)}).ok());
  };
  for (int i = 0; i < 1500; ++i) append();
  const fs::path path = folder / "backups" / "a.sqlite";
  auto progress = store->Backup(path);
  ASSERT_TRUE(progress.ok()) << progress.status().ToString();
  EXPECT_EQ(store->Backup(folder / "backups" / "b.sqlite").status().code(), StatusCode::kUnavailable);
  std::size_t pieces = 0;
  for (; progress.ok() && progress->fraction < 1.0; ++pieces) {
    EXPECT_FALSE(fs::exists(path)) << "half a copy must not be seen";
    ASSERT_TRUE(store->Maintain().ok());
    if (progress->fraction < 0.4) append();
    progress = store->Backup(path);
  }
  ASSERT_TRUE(progress.ok()) << progress.status().ToString();
  EXPECT_GT(pieces, 5U);
  EXPECT_EQ(progress->sha256, Sha256HexOfFile(path).value());
  const auto kept = EventStore::Restore(path, folder / "restored");
  ASSERT_TRUE(kept.ok()) << kept.status().ToString();
  EXPECT_TRUE(kept->empty());
  EXPECT_EQ(Numbers(*MustOpen(folder / "restored")), numbers);
}

TEST(EventStoreTest, RestoresABackupOverALogThatIsKept) {
  const TempDir folder;
  {
    const auto store = MustOpen(folder / "state");
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(1)}).ok());
    while (store->Backup(folder / "a.sqlite")->fraction < 1.0) ASSERT_TRUE(store->Maintain().ok());
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(2)}).ok());
    EXPECT_EQ(EventStore::Restore(folder / "a.sqlite", folder / "state").status().code(), StatusCode::kUnavailable) << "it is in use";
  }
  const auto kept = EventStore::Restore(folder / "a.sqlite", folder / "state");
  ASSERT_TRUE(kept.ok()) << kept.status().ToString();
  EXPECT_EQ(Numbers(*MustOpen(folder / "state")), (std::vector<std::uint32_t>{1}));
  EXPECT_EQ(Numbers(*MustOpen(*kept)), (std::vector<std::uint32_t>{1, 2}));
}

TEST(EventStoreTest, RefusesABackupThatIsNoneOrDamaged) {
  const TempDir folder;
  WriteFileContents(folder / "text", "this is no database, whatever its name says; it is long enough to look at");
  EXPECT_EQ(EventStore::Restore(folder / "text", folder / "state").status().code(), StatusCode::kCorrupt);
  {
    const auto store = MustOpen(folder / "state");
    ASSERT_TRUE(store->Append(std::vector<v1::LogEvent>(200, MakeEvent(1, 1000))).ok());
    while (store->Backup(folder / "a.sqlite")->fraction < 1.0) ASSERT_TRUE(store->Maintain().ok());
  }
  std::string bytes = FileContents(folder / "a.sqlite");
  for (std::size_t i = 8192; i < 8292; ++i) bytes[i] = '\x7f';
  WriteFileContents(folder / "damaged", bytes);
  EXPECT_EQ(EventStore::Restore(folder / "damaged", folder / "state").status().code(), StatusCode::kCorrupt);
  EXPECT_EQ(MustOpen(folder / "state")->event_count(), 200U) << "what was there stays";
}

TEST(EventStoreTest, ReplaysTheSnapshotThenWhatCameAfterIt) {
  const TempDir folder;
  {
    const auto store = MustOpen(folder.path());
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(1), MakeEvent(2), MakeEvent(3)}).ok());
    ASSERT_TRUE(store->Compact(std::vector{MakeEvent(30)}).ok());
    EXPECT_EQ(store->snapshot_count(), 1U);
    EXPECT_EQ(store->event_count(), 0U);
    ASSERT_TRUE(store->Append(std::vector{MakeEvent(4)}).ok());
  }
  const auto store = MustOpen(folder.path());
  EXPECT_EQ(store->snapshot_count(), 1U);
  EXPECT_EQ(store->event_count(), 1U);
  std::vector<std::uint32_t> numbers;
  ASSERT_TRUE(store
                  ->Replay([&](std::int64_t sequence, const v1::LogEvent& event) {
                    EXPECT_EQ(sequence, numbers.empty() ? 0 : 4);
                    numbers.push_back(event.attempt_started().attempt());
                    return Status();
                  })
                  .ok());
  EXPECT_EQ(numbers, (std::vector<std::uint32_t>{30, 4}));
}

TEST(EventStoreTest, KeepsTheLogWhenThereIsNoRoomForASnapshotAndGoesOnWhenThereIs) {
  const TempDir folder;
  const auto store = MustOpen(folder.path());
  ASSERT_TRUE(store->Append(std::vector{MakeEvent(1), MakeEvent(2)}).ok());
  ASSERT_TRUE(store->SetBytesMax(64 << 10).ok());
  const std::vector<v1::LogEvent> large(20, MakeEvent(7, 5000));
  EXPECT_EQ(store->Compact(large).code(), StatusCode::kExhausted);
  EXPECT_EQ(ReadAll(*store).value(), (std::vector<std::uint32_t>{1, 2}));
  ASSERT_TRUE(store->SetBytesMax(0).ok());
  EXPECT_TRUE(store->Compact(large).ok());
  EXPECT_EQ(store->snapshot_count(), 20U);
}

TEST(EventStoreTest, GivesRoomBackWhenALongLogIsCompacted) {
  const TempDir folder;
  const auto store = MustOpen(folder.path());
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(store->Append(std::vector<v1::LogEvent>(50, MakeEvent(1, 1000))).ok());
  ASSERT_TRUE(store->Compact(std::vector{MakeEvent(1)}).ok());
  EXPECT_LT(fs::file_size(folder / "events.sqlite"), 100'000U);
}

TEST(EventStoreTest, RefusesAnotherProgramsDatabase) {
  const TempDir folder;
  ExecuteSql(folder / "events.sqlite", "CREATE TABLE theirs (x)");
  const auto store = EventStore::Open(folder.path());
  ASSERT_FALSE(store.ok());
  EXPECT_EQ(store.status().code(), StatusCode::kInvalidInput);
  EXPECT_THAT(store.status().message(), HasSubstr("another program's database"));
}

TEST(EventStoreTest, RefusesAFileThatIsNoDatabase) {
  const TempDir folder;
  WriteFileContents(folder / "events.sqlite", std::string(5000, 'z'));
  const auto store = EventStore::Open(folder.path());
  ASSERT_FALSE(store.ok());
  EXPECT_EQ(store.status().code(), StatusCode::kCorrupt);
  EXPECT_THAT(store.status().message(), HasSubstr((folder / "events.sqlite").string()));
}

TEST(EventStoreTest, NamesAnEventThatIsNoMessage) {
  const TempDir folder;
  MustOpen(folder.path());
  ExecuteSql(folder / "events.sqlite", "INSERT INTO events (kind, body) VALUES ('x', x'ffff')");
  const auto store = MustOpen(folder.path());
  const Status status = ReadAll(*store).status();
  EXPECT_EQ(status.code(), StatusCode::kCorrupt);
  EXPECT_THAT(status.message(), HasSubstr("event 1 cannot be read"));
}

TEST(EventStoreTest, RefusesAStateFolderThatIsAFile) {
  const TempDir folder;
  WriteFileContents(folder / "state", "x");
  EXPECT_FALSE(EventStore::Open(folder / "state").ok());
}

TEST(EventStoreTest, AppendsAllOrNothingWhenThereIsNoRoomAndNamesThePath) {
  const TempDir folder;
  const auto store = MustOpen(folder.path(), {.bytes_max = 64 << 10});
  std::size_t appended = 0;
  Status status;
  while (status.ok() && appended < 1000) {
    status = store->Append(
        std::vector{MakeEvent(static_cast<std::uint32_t>(appended + 1), 3000), MakeEvent(static_cast<std::uint32_t>(appended + 2), 3000)});
    if (status.ok()) appended += 2;
  }
  ASSERT_FALSE(status.ok());
  EXPECT_EQ(status.code(), StatusCode::kExhausted);
  EXPECT_THAT(status.message(), HasSubstr((folder / "events.sqlite").string()));
  EXPECT_GT(appended, 4U);
  EXPECT_EQ(ReadAll(*store)->size(), appended);
}

}  // namespace
}  // namespace trem
