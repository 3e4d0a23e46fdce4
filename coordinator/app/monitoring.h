#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <span>
#include <string>

#include "coordinator/app/gate.h"
#include "coordinator/app/metrics.h"
#include "coordinator/app/shell.h"
#include "coordinator/data/artefact_server.h"
#include "coordinator/http/http_server.h"
#include "proto/channel/router_channel.h"

namespace trem {

// Keeps the metrics up to date and serves them, with /healthz (200 while the coordinator's thread goes round, or reads its log at the
// start) and /readyz (200 once it also answers workers and clients). All calls belong to the coordinator's thread.
class Monitoring {
 public:
  // Without an address in `options` nothing is served.
  static Result<std::unique_ptr<Monitoring>> Start(const HttpServerOptions& options);

  // From now on workers and clients are answered.
  void BecomeReady();
  // Around making events durable.
  void BeginCommit() { commit_began_ = Clock::now(); }
  void EndCommit(std::span<const v1::LogEvent> events) { metrics_.ObserveCommit(events, Clock::now() - commit_began_); }
  // Once a turn of the coordinator's loop; the metrics follow once a second.
  // `data_lane` may be null.
  void Observe(TimeMs now_ms, const RouterChannel& channel, const Gate& gate, const ArtefactServer* data_lane, const Shell& shell);

  // Where it is served; empty: nowhere.
  std::string url() const { return server_ ? server_->url() : std::string(); }

 private:
  using Clock = std::chrono::steady_clock;
  Monitoring() = default;
  HttpResponse Answer(const std::string& path) const;
  // Seconds since the last turn.
  double Silence() const;

  Metrics metrics_;
  std::atomic<bool> is_ready_{false};
  std::atomic<Clock::rep> last_turn_{0};
  Clock::time_point commit_began_{};
  TimeMs next_update_ms_ = 0;
  std::unique_ptr<HttpServer> server_;  // Last: its thread reads the others.
};

}  // namespace trem
