#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "mosaic/base/status.h"
#include "proto/trem/v1/events.pb.h"

namespace trem {

struct EventStoreOptions {
  // The log refuses to grow beyond this, with kExhausted. Set it where a quota would otherwise fill a shared disk. 0: no limit.
  std::uint64_t bytes_max = 0;
};

// The coordinator's memory: an append-only log of events in <folder>/events.sqlite (SQLite, write-ahead log, synchronous = FULL). What
// Append has returned Ok for survives a crash of the process or machine; what it has not is not there at all. A snapshot stands for the
// events before it. What takes long (a snapshot, a backup) is done in pieces by Maintain, between Appends.
class EventStore {
 public:
  // Gives events one after the other, then nullopt.
  using EventSource = std::function<std::optional<v1::LogEvent>()>;

  struct BackupProgress {
    double fraction = 0.0;  // 0..1; 1: it is whole and durable, and what follows is known.
    std::filesystem::path path;
    std::uint64_t bytes = 0;
    std::string sha256;
  };

  // Creates folder and log when missing. Holds the folder for this process until destroyed: kUnavailable, with the other's process id
  // when known, when another coordinator has it. A log of an older schema version is migrated, in one transaction. kInvalidInput when it
  // was written by a newer one or is some other program's database; kCorrupt when it is no database; kExhausted when the disk is full.
  static Result<std::unique_ptr<EventStore>> Open(const std::filesystem::path& folder, const EventStoreOptions& options = {});
  ~EventStore();
  EventStore(const EventStore&) = delete;
  EventStore& operator=(const EventStore&) = delete;

  // Appends all of `events` or, on failure, none of them (kExhausted when the disk is full; the message names the path). One fsync.
  Status Append(std::span<const v1::LogEvent> events);

  // Begins to put a snapshot, in the form of the shortest log that gives the present state, in the place of everything that is there now.
  // `next` is called by Maintain. Until the last of it is there, the log is what it was, and takes events as ever; then it is the snapshot
  // and what was appended since. Costs room for both. Nothing happens while another one is on its way.
  void BeginCompaction(EventSource next);
  bool is_compacting() const;
  // All of a compaction at once.
  Status Compact(std::span<const v1::LogEvent> snapshot);

  // Makes a copy of the log as it is at some moment from now on, at `path`, which nobody sees before it is whole; or, asked again, tells
  // how far that is. A file that is there already counts as made. kUnavailable while another copy is being made.
  Result<BackupProgress> Backup(const std::filesystem::path& path);
  // Puts a backup into `folder` as its log; what was there is kept in a folder beside it, whose name is returned (empty: nothing was
  // there). The folder must not be in use (kUnavailable). kInvalidInput or kCorrupt when the file is no log that this version reads.
  static Result<std::filesystem::path> Restore(const std::filesystem::path& backup, const std::filesystem::path& folder);

  // Goes on with a compaction, with clearing away after one, or with a backup, for some milliseconds. True: call it again soon. An error
  // ends what it was about, and leaves the log as it was.
  Result<bool> Maintain();

  // Calls `visit` with every event, oldest first: first those of the snapshot, with sequence number 0, then those after it with theirs,
  // which rise by one; stops at the first error and returns it.
  Status Replay(const std::function<Status(std::int64_t sequence, const v1::LogEvent& event)>& visit) const;

  // Events of the snapshot, and after it.
  std::uint64_t snapshot_count() const;
  std::uint64_t event_count() const;
  // Changes EventStoreOptions::bytes_max.
  Status SetBytesMax(std::uint64_t bytes_max);

  const std::filesystem::path& path() const;

 private:
  friend struct BackupJob;
  friend struct Compaction;
  struct State;
  explicit EventStore(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
