#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>

#include "mosaic/base/status.h"
#include "proto/trem/v1/events.pb.h"

namespace trem {

struct EventStoreOptions {
  // The log refuses to grow beyond this, with kExhausted. Set it where a quota would otherwise fill a shared disk. 0: no limit.
  std::uint64_t bytes_max = 0;
};

// The coordinator's memory: an append-only log of events in <folder>/events.sqlite (SQLite, write-ahead log, synchronous = FULL). What
// Append has returned Ok for survives a crash of the process or machine; what it has not is not there at all. A snapshot stands for the
// events before it.
class EventStore {
 public:
  // Creates folder and log when missing. Holds the folder for this process until destroyed: kUnavailable, with the other's process id
  // when known, when another coordinator has it. A log of an older schema version is migrated, in one transaction. kInvalidInput when it
  // was written by a newer one or is some other program's database; kCorrupt when it is no database; kExhausted when the disk is full.
  static Result<std::unique_ptr<EventStore>> Open(const std::filesystem::path& folder, const EventStoreOptions& options = {});
  ~EventStore();
  EventStore(const EventStore&) = delete;
  EventStore& operator=(const EventStore&) = delete;

  // Appends all of `events` or, on failure, none of them (kExhausted when the disk is full; the message names the path). One fsync.
  Status Append(std::span<const v1::LogEvent> events);

  // Puts a snapshot, in the form of the shortest log that gives the same state, in the place of everything that is there. All or nothing,
  // as Append; costs room for both until it is done.
  Status Compact(std::span<const v1::LogEvent> snapshot);

  // Calls `visit` with every event, oldest first: first those of the snapshot, with sequence number 0, then those after it with theirs (1,
  // 2, ...); stops at the first error and returns it.
  Status Replay(const std::function<Status(std::int64_t sequence, const v1::LogEvent& event)>& visit) const;

  // Events of the snapshot, and after it.
  std::uint64_t snapshot_count() const;
  std::uint64_t event_count() const;
  // Changes EventStoreOptions::bytes_max.
  Status SetBytesMax(std::uint64_t bytes_max);

  const std::filesystem::path& path() const;

 private:
  struct State;
  // Runs `change` in a transaction of its own: all or nothing.
  Status Transact(const std::function<Status()>& change);
  explicit EventStore(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
