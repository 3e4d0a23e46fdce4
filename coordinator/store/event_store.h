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
// Append has returned Ok for survives a crash of the process or machine; what it has not is not there at all.
class EventStore {
 public:
  // Creates folder and log when missing. Holds the folder for this process until destroyed: kUnavailable, with the other's process id
  // when known, when another coordinator has it. kInvalidInput when the log was written by another schema version or is some other
  // program's database; kCorrupt when it is no database; kExhausted when the disk is full.
  static Result<std::unique_ptr<EventStore>> Open(const std::filesystem::path& folder, const EventStoreOptions& options = {});
  ~EventStore();
  EventStore(const EventStore&) = delete;
  EventStore& operator=(const EventStore&) = delete;

  // Appends all of `events` or, on failure, none of them (kExhausted when the disk is full; the message names the path). One fsync.
  Status Append(std::span<const v1::LogEvent> events);

  // Calls `visit` with every event, oldest first, with its sequence number (1, 2, ...); stops at the first error and returns it.
  Status Replay(const std::function<Status(std::int64_t sequence, const v1::LogEvent& event)>& visit) const;

  const std::filesystem::path& path() const;

 private:
  struct State;
  explicit EventStore(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
