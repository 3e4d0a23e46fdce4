// Question: do the scheduler and its log hold what years of work put into them? Prints the duration of a scheduler step (median, 99th
// percentile, largest) with --tasks known tasks and --workers connected workers, memory a hundred thousand tasks, durable appends a second,
// and how long a coordinator needs to rebuild its state from a log of --events events, before and after compaction.
//
// Baseline: a step that reads one cache line per level of a search tree over 10^6 entries waits for about 20 misses of 100 ns: 2 us.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <deque>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "coordinator/scheduling/scheduler.h"
#include "coordinator/store/event_store.h"
#include "mosaic/base/check.h"
#include "mosaic/base/rng.h"
#include "tests/bench/no_op_task.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kWindows = 1'000;  // Of a job.

double Seconds(Clock::time_point since) { return std::chrono::duration<double>(Clock::now() - since).count(); }

double ResidentMiB() {
  std::ifstream file("/proc/self/statm");
  double total = 0.0, resident = 0.0;
  file >> total >> resident;
  return resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / (1 << 20);
}

TaskDoneEvent DoneOf(const DispatchEffect& dispatch) {
  TaskDoneEvent event;
  event.worker_id = dispatch.worker_id;
  event.attempt = {dispatch.task.key(), dispatch.attempt};
  event.result = bench::NoOpResult(dispatch.task, kWindows);
  event.elapsed_ms = 20'000;
  event.peak_memory_bytes = 300 << 20;
  return event;
}

class World {
 public:
  std::vector<Effect> Step(const Event& event) {
    const auto start = Clock::now();
    std::vector<Effect> effects = scheduler.Step(now_ms, event);
    durations[event.index()].push_back(Seconds(start) * 1e6);
    for (const Effect& effect : effects) {
      if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) out.push_back(*dispatch);
      if (const auto* append = std::get_if<AppendEffect>(&effect); append != nullptr && keep_log) log.push_back(append->event);
    }
    return effects;
  }
  void Hello(std::size_t number) {
    WorkerHelloEvent hello;
    hello.worker_id = "worker-" + std::to_string(number);
    hello.host = "host-" + std::to_string(number / 32);
    hello.memory_bytes_max = (4ULL + number % 5) << 30;
    Step(hello);
  }
  void Submit(std::size_t number) {
    const std::string name = "job-" + std::to_string(number);
    Step(SubmitJobEvent{name, testing::FakeSortie(name), "user-" + std::to_string(number % 20), static_cast<int>(number % 3)});
  }

  Scheduler scheduler;
  TimeMs now_ms = 1'000;
  std::deque<DispatchEffect> out;
  std::map<std::size_t, std::vector<double>> durations;  // By index of the event's type, microseconds.
  bool keep_log = false;
  std::vector<v1::LogEvent> log;
};

void PrintDurations(const char* what, std::vector<double> us) {
  if (us.empty()) return;
  std::sort(us.begin(), us.end());
  std::printf("  %-22s %9zu steps: median %8.1f us, p99 %8.1f us, largest %10.1f us\n", what, us.size(), us[us.size() / 2],
              us[us.size() * 99 / 100], us.back());
}

void MeasureSteps(std::size_t task_count, std::size_t worker_count, std::size_t step_count) {
  World world;
  const double before = ResidentMiB();
  const auto start = Clock::now();
  const std::size_t job_count = std::max<std::size_t>(1, task_count / kWindows);
  for (std::size_t i = 0; i < job_count; ++i) world.Submit(i);
  // Every source is read at once by one worker with room for all of them; what follows is handed back.
  WorkerHelloEvent reader;
  reader.worker_id = "reader";
  reader.credit = static_cast<std::uint32_t>(job_count);
  world.Step(reader);
  while (!world.out.empty()) {
    const DispatchEffect dispatch = world.out.front();
    world.out.pop_front();
    if (dispatch.task.kind() == v1::INGEST) world.Step(DoneOf(dispatch));
  }
  world.Step(WorkerGoodbyeEvent{"reader"});
  world.out.clear();
  const double mib = ResidentMiB() - before;
  std::printf("%zu jobs, %zu tasks known after %.1f s; %.0f MiB, %.1f MiB a 100 000 tasks\n", job_count, job_count * kWindows,
              Seconds(start), mib, mib / (static_cast<double>(job_count) * kWindows / 1e5));
  world.durations.clear();
  for (std::size_t i = 0; i < worker_count; ++i) world.Hello(i);
  PrintDurations("Hello and hand-out", world.durations[Event(WorkerHelloEvent{}).index()]);
  world.durations.clear();
  Rng rng({1, 2});
  for (std::size_t i = 0; i < step_count; ++i) {
    if (i % 100 == 0) {
      world.now_ms += 10;
      world.Step(TickEvent{});
      continue;
    }
    // Some task that is out, whichever: the queue is turned over.
    const DispatchEffect dispatch = world.out.front();
    world.out.pop_front();
    if (rng.Uniform() < 0.5) {
      world.Step(DoneOf(dispatch));
    } else {
      world.Step(ProgressEvent{dispatch.worker_id, {dispatch.task.key(), dispatch.attempt}, 0.5});
      world.out.push_back(dispatch);
    }
  }
  PrintDurations("Done and hand-out", world.durations[Event(TaskDoneEvent{}).index()]);
  PrintDurations("Progress", world.durations[Event(ProgressEvent{}).index()]);
  PrintDurations("Tick", world.durations[Event(TickEvent{}).index()]);
}

void Check(const Status& status) { TREM_CHECK_MSG(status.ok(), status.ToString()); }

void MeasureRecovery(const std::filesystem::path& folder, const char* what) {
  const auto start = Clock::now();
  const std::clock_t cpu_start = std::clock();
  auto store = EventStore::Open(folder);
  Check(store.status());
  Scheduler scheduler;
  std::size_t count = 0;
  Check((*store)->Replay([&](std::int64_t, const v1::LogEvent& event) {
    ++count;
    return scheduler.Restore(event);
  }));
  std::printf("  state rebuilt from %s of %zu events in %.2f s, %.2f s of CPU time\n", what, count, Seconds(start),
              static_cast<double>(std::clock() - cpu_start) / CLOCKS_PER_SEC);
}

// A log as jobs write it: every task handed out and done once.
void MeasureStore(std::size_t event_count, const std::filesystem::path& folder) {
  World world;
  world.keep_log = true;
  for (std::size_t i = 0; i < 200; ++i) world.Hello(i);
  for (std::size_t job = 0; world.log.size() < event_count; ++job) {
    world.Submit(job);
    while (!world.out.empty() && world.log.size() < event_count) {
      const DispatchEffect dispatch = world.out.front();
      world.out.pop_front();
      world.Step(DoneOf(dispatch));
    }
  }
  world.log.resize(event_count);
  auto store = EventStore::Open(folder);
  Check(store.status());
  auto start = Clock::now();
  constexpr std::size_t kBatch = 256;  // As many messages share one fsync in a busy coordinator.
  for (std::size_t i = 0; i < world.log.size(); i += kBatch) {
    Check((*store)->Append(std::span(world.log).subspan(i, std::min(kBatch, world.log.size() - i))));
  }
  std::printf("%zu events: %.0f durable appends/s in batches of %zu\n", event_count, static_cast<double>(event_count) / Seconds(start),
              kBatch);
  store->reset();
  MeasureRecovery(folder, "a log");
  {
    auto again = EventStore::Open(folder);
    Check(again.status());
    start = Clock::now();
    std::vector<double> pieces_us;
    (*again)->BeginCompaction(world.scheduler.BeginSnapshot());
    const double began_ms = Seconds(start) * 1e3;
    for (bool more = true; more;) {
      const auto piece_start = Clock::now();
      const auto result = (*again)->Maintain();
      Check(result.status());
      more = *result;
      pieces_us.push_back(Seconds(piece_start) * 1e6);
    }
    std::printf("  compacted in %.2f s; begun in %.1f ms, then in pieces between which messages are served\n", Seconds(start), began_ms);
    PrintDurations("piece", pieces_us);
  }
  MeasureRecovery(folder, "a snapshot");
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  std::size_t task_count = 1'000'000, worker_count = 10'000, step_count = 200'000, event_count = 1'000'000;
  std::string folder = (std::filesystem::temp_directory_path() / ("trem-service-scale-" + std::to_string(::getpid()))).string();
  CLI::App app("Scale of the scheduler and of its log.", "service_scale");
  app.add_option("--tasks", task_count, "Tasks in memory")->capture_default_str();
  app.add_option("--workers", worker_count, "Connected workers")->capture_default_str();
  app.add_option("--steps", step_count, "Measured steps")->capture_default_str();
  app.add_option("--events", event_count, "Events in the log; 0: skip")->capture_default_str();
  app.add_option("--folder", folder, "Where the log is written; removed afterwards")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  if (task_count > 0) trem::MeasureSteps(task_count, worker_count, step_count);
  if (event_count > 0) trem::MeasureStore(event_count, folder);
  std::filesystem::remove_all(folder);
  return 0;
}
