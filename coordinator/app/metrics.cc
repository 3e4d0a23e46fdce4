#include "coordinator/app/metrics.h"

#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>
#include <prometheus/text_serializer.h>

#include <algorithm>
#include <cctype>
#include <map>

#include "mosaic/base/version.h"

namespace trem {
namespace {

using prometheus::Counter;
using prometheus::Family;
using prometheus::Gauge;
using prometheus::Histogram;

const Histogram::BucketBoundaries kTaskSeconds = {0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000};
const Histogram::BucketBoundaries kCommitSeconds = {0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3};

std::string LowerCase(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

// Brings a counter to a total that somebody else counts.
void RaiseTo(Counter* counter, std::uint64_t total) {
  const double missing = static_cast<double>(total) - counter->Value();
  if (missing > 0) counter->Increment(missing);
}

}  // namespace

struct Metrics::State {
  prometheus::Registry registry;

  Gauge& NewGauge(const char* name, const char* help, const prometheus::Labels& labels = {}) {
    return prometheus::BuildGauge().Name(name).Help(help).Register(registry).Add(labels);
  }
  Counter& NewCounter(const char* name, const char* help, const prometheus::Labels& labels = {}) {
    return prometheus::BuildCounter().Name(name).Help(help).Register(registry).Add(labels);
  }
  Counter& Refused(const char* lane, const char* reason) {
    return NewCounter("trem_messages_refused_total", "Messages that were not let through, by reason", {{"lane", lane}, {"reason", reason}});
  }

  // What a socket counts.
  struct Lane {
    Lane(State* state, const char* lane)
        : connections(state->NewGauge("trem_connections", "Connections that stand", {{"lane", lane}})),
          accepted(state->NewCounter("trem_connections_accepted_total", "Connections accepted", {{"lane", lane}})),
          closed(state->NewCounter("trem_connections_closed_total", "Connections that have ended, whoever closed them", {{"lane", lane}})),
          refused_full(Refused(state, lane, "full")),
          refused_handshake(Refused(state, lane, "handshake")),
          refused_key(Refused(state, lane, "key")),
          received(Messages(state, lane, "received")),
          sent(Messages(state, lane, "sent")),
          bytes_received(Bytes(state, lane, "received")),
          bytes_sent(Bytes(state, lane, "sent")) {}
    void Observe(const ChannelCounters& channel) {
      connections.Set(static_cast<double>(channel.connections));
      RaiseTo(&accepted, channel.accepted);
      RaiseTo(&closed, channel.accepted - std::min(channel.accepted, channel.connections));
      RaiseTo(&refused_full, channel.refused_full);
      RaiseTo(&refused_key, channel.keys_refused);
      RaiseTo(&refused_handshake, channel.handshakes_failed);
      RaiseTo(&received, channel.messages_received);
      RaiseTo(&sent, channel.messages_sent);
      RaiseTo(&bytes_received, channel.bytes_received);
      RaiseTo(&bytes_sent, channel.bytes_sent);
    }

   private:
    static Counter& Refused(State* state, const char* lane, const char* reason) {
      return state->NewCounter("trem_connections_refused_total", "Connections that were not let in, by reason",
                               {{"lane", lane}, {"reason", reason}});
    }
    static Counter& Messages(State* state, const char* lane, const char* direction) {
      return state->NewCounter("trem_messages_total", "Messages", {{"lane", lane}, {"direction", direction}});
    }
    static Counter& Bytes(State* state, const char* lane, const char* direction) {
      return state->NewCounter("trem_message_bytes_total", "Bytes of messages", {{"lane", lane}, {"direction", direction}});
    }

    Gauge& connections;
    Counter &accepted, &closed, &refused_full, &refused_handshake, &refused_key, &received, &sent, &bytes_received, &bytes_sent;
  };

  Gauge& waiting =
      NewGauge("trem_tasks_waiting", "Tasks of the stages that running jobs are in, which no worker holds: scale workers by this");
  Gauge& running = NewGauge("trem_tasks_running", "Tasks that workers hold");
  Gauge& workers = NewGauge("trem_workers", "Workers that are heard of");
  Gauge& store_bytes = NewGauge("trem_artefact_store_bytes", "Bytes of the artefact store, as the last sweep has found them");
  Lane control{this, "control"};
  Lane data{this, "data"};
  Counter& wrong_role = Refused("control", "role");
  Counter& too_many = Refused("control", "rate");
  Counter& too_large = Refused("control", "size");
  Counter& malformed = Refused("control", "malformed");
  Counter& data_malformed = Refused("data", "malformed");
  Counter& attempts = NewCounter("trem_attempts_started_total", "Times that a task was handed to a worker");
  Counter& leases_lost =
      NewCounter("trem_leases_lost_total", "Leases that ended without a result: no progress, the worker gone, or the task handed back");
  Counter& differed = NewCounter("trem_results_differed_total", "Second results of a task whose bytes were other ones");
  Counter& events = NewCounter("trem_store_events_total", "Events made durable");
  Histogram& commit_seconds = prometheus::BuildHistogram()
                                  .Name("trem_store_commit_seconds")
                                  .Help("Time to make a group of events durable, fsync included")
                                  .Register(registry)
                                  .Add({}, kCommitSeconds);
  Family<Histogram>& task_seconds = prometheus::BuildHistogram()
                                        .Name("trem_task_duration_seconds")
                                        .Help("Computing time of tasks that were done, by kind")
                                        .Register(registry);
  Family<Gauge>& jobs = prometheus::BuildGauge().Name("trem_jobs").Help("Jobs, by state").Register(registry);
};

Metrics::Metrics() : state_(std::make_unique<State>()) {
  state_
      ->NewGauge("trem_build_info", "1; what runs is in the labels",
                 {{"version", TREM_VERSION}, {"engine_revision", kEngineRevision}, {"protocol_version", std::to_string(kProtocolVersion)}})
      .Set(1.0);
  state_->NewGauge("trem_start_time_seconds", "When this process started, seconds since 1970")
      .Set(std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count());
}

Metrics::~Metrics() = default;

void Metrics::ObserveCommit(std::span<const v1::LogEvent> events, std::chrono::duration<double> elapsed) {
  state_->commit_seconds.Observe(elapsed.count());
  state_->events.Increment(static_cast<double>(events.size()));
  for (const v1::LogEvent& event : events) {
    if (event.has_attempt_started()) state_->attempts.Increment();
    if (event.has_result_differed()) state_->differed.Increment();
    if (!event.has_task_committed()) continue;
    const v1::TaskCommitted& committed = event.task_committed();
    state_->task_seconds.Add({{"kind", LowerCase(v1::TaskKind_Name(committed.kind()))}}, kTaskSeconds)
        .Observe(static_cast<double>(committed.elapsed_ms()) / 1000.0);
  }
}

void Metrics::ObserveTraffic(const ChannelCounters& control, const GateCounters& gate, const ChannelCounters& data) {
  state_->control.Observe(control);
  state_->data.Observe(data);
  RaiseTo(&state_->data_malformed, data.garbage);
  RaiseTo(&state_->wrong_role, gate.wrong_role);
  RaiseTo(&state_->too_many, gate.too_many);
  RaiseTo(&state_->too_large, gate.too_large);
  RaiseTo(&state_->malformed, gate.malformed);
}

void Metrics::ObserveFleet(std::span<const v1::JobStatus> jobs, std::size_t worker_count) {
  std::map<v1::JobState, int> by_state = {
      {v1::JOB_RUNNING, 0}, {v1::JOB_DONE, 0}, {v1::JOB_FAILED, 0}, {v1::JOB_CANCELLED, 0}, {v1::JOB_DONE_IN_PART, 0}};
  std::uint64_t waiting = 0;
  std::uint64_t running = 0;
  for (const v1::JobStatus& job : jobs) {
    ++by_state[job.state()];
    if (job.state() != v1::JOB_RUNNING) continue;
    for (const v1::StageStatus& stage : job.stages()) {
      running += stage.running();
      if (stage.done() >= stage.total()) continue;
      // Later stages wait for this one: workers would not help them yet.
      if (stage.total() > stage.done() + stage.running()) waiting += stage.total() - stage.done() - stage.running();
      break;
    }
  }
  for (const auto& [state, count] : by_state) {
    state_->jobs.Add({{"state", LowerCase(v1::JobState_Name(state).substr(4))}}).Set(count);
  }
  state_->waiting.Set(static_cast<double>(waiting));
  state_->running.Set(static_cast<double>(running));
  state_->workers.Set(static_cast<double>(worker_count));
}

void Metrics::ObserveTotals(std::uint64_t leases_lost, std::uint64_t store_bytes) {
  RaiseTo(&state_->leases_lost, leases_lost);
  state_->store_bytes.Set(static_cast<double>(store_bytes));
}

std::string Metrics::Text() const { return prometheus::TextSerializer().Serialize(state_->registry.Collect()); }

}  // namespace trem
