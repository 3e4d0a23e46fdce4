#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "coordinator/app/gate.h"
#include "proto/channel/router_channel.h"
#include "proto/trem/v1/events.pb.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// What Prometheus reads (docs/OPERATIONS.md lists the names). The coordinator's thread observes, the HTTP server's thread asks for the
// text.
class Metrics {
 public:
  Metrics();
  ~Metrics();
  Metrics(const Metrics&) = delete;
  Metrics& operator=(const Metrics&) = delete;

  // Events that are durable now, and how long that took.
  void ObserveCommit(std::span<const v1::LogEvent> events, std::chrono::duration<double> elapsed);
  // Totals of the sockets and of the gate so far.
  void ObserveTraffic(const ChannelCounters& control, const GateCounters& gate, const ChannelCounters& data);
  void ObserveFleet(std::span<const v1::JobStatus> jobs, std::size_t worker_count);
  void ObserveTotals(std::uint64_t leases_lost, std::uint64_t store_bytes);

  // All of it in Prometheus' text format.
  std::string Text() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace trem
