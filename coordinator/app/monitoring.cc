#include "coordinator/app/monitoring.h"

#include <vector>

namespace trem {
namespace {

constexpr TimeMs kUpdateIntervalMs = 1'000;
// A turn takes milliseconds; a slow disk may hold one for a while.
constexpr double kReadySilenceSecondsMax = 10.0;
constexpr double kHealthySilenceSecondsMax = 60.0;

}  // namespace

Result<std::unique_ptr<Monitoring>> Monitoring::Start(const HttpServerOptions& options) {
  std::unique_ptr<Monitoring> monitoring(new Monitoring());
  if (options.address.empty()) return monitoring;
  TREM_ASSIGN_OR_RETURN(monitoring->server_,
                        HttpServer::Start(options, [self = monitoring.get()](const std::string& path) { return self->Answer(path); }));
  return monitoring;
}

void Monitoring::BecomeReady() {
  last_turn_ = Clock::now().time_since_epoch().count();
  is_ready_ = true;
}

void Monitoring::Observe(TimeMs now_ms, const RouterChannel& channel, const Gate& gate, const ArtefactServer* data_lane,
                         const Shell& shell) {
  last_turn_ = Clock::now().time_since_epoch().count();
  if (now_ms < next_update_ms_ || !server_) return;
  next_update_ms_ = now_ms + kUpdateIntervalMs;
  server_->CloseOldConnections();
  metrics_.ObserveTraffic(channel.counters(), gate.counters(), data_lane != nullptr ? data_lane->counters() : ChannelCounters());
  const std::vector<v1::JobStatus> jobs = shell.scheduler().JobStatuses();
  metrics_.ObserveFleet(jobs, shell.scheduler().WorkerStatuses().size());
  metrics_.ObserveTotals(shell.scheduler().leases_lost(), shell.store_bytes());
}

double Monitoring::Silence() const {
  return std::chrono::duration<double>(Clock::now().time_since_epoch() - Clock::duration(last_turn_.load())).count();
}

HttpResponse Monitoring::Answer(const std::string& path) const {
  constexpr const char* kMetricsType = "text/plain; version=0.0.4; charset=utf-8";
  if (path == "/metrics") return {200, kMetricsType, metrics_.Text()};
  if (path == "/healthz") {
    if (!is_ready_ || Silence() < kHealthySilenceSecondsMax) return {200, "text/plain", "ok\n"};
    return {503, "text/plain", "the coordinator hangs\n"};
  }
  if (path == "/readyz") {
    if (!is_ready_) return {503, "text/plain", "reading the event log\n"};
    if (Silence() < kReadySilenceSecondsMax) return {200, "text/plain", "ready\n"};
    return {503, "text/plain", "the coordinator is busy\n"};
  }
  return {404, "text/plain", "there is /metrics, /healthz and /readyz\n"};
}

}  // namespace trem
