// Question: what does the service cost on a real job: against the engine called task by task in one process, and what do two workers gain
// over one? Prints wall and CPU time of the job run directly, by `trem run --workers 1` and by `trem run --workers 2`, and their ratios.
//
// Baseline: the direct run does the same tasks in the order of the plan, with the same artefact store (every result hashed, synced and
// renamed), and without log, messages and processes. Aims: at most 10 % more CPU time with one worker; two workers on two cores at
// least 1.8 times as fast. The mosaics of all runs must be the same bytes. The stages' times say where the rest is: a stage of one task
// is as long as its task, the others as long as their tasks together, divided by the workers.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/cli/job_report.h"
#include "coordinator/scheduling/job_graph.h"
#include "mosaic/base/artefact_store.h"
#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"
#include "proto/codec/sortie_spec.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

struct Cost {
  double wall_s = 0.0;
  double cpu_s = 0.0;
  std::map<std::string, double> stages_s;  // Sums over their tasks, which may run at once.
};

double CpuSeconds(int who) {
  rusage usage{};
  ::getrusage(who, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) * 1e-6;
}

template <typename Work>
Cost Measure(int who, Work work) {
  const auto start = Clock::now();
  const double cpu = CpuSeconds(who);
  work();
  return {std::chrono::duration<double>(Clock::now() - start).count(), CpuSeconds(who) - cpu, {}};
}

// All tasks of the job, one after the other. Returns the digest of the mosaic.
std::string RunDirectly(const v1::Sortie& sortie, const fs::path& folder, std::map<std::string, double>* stages_s) {
  const auto store = ArtefactStore::Open(folder);
  TREM_CHECK_MSG(store.ok(), store.status().ToString());
  JobGraph graph("direct", sortie);
  std::deque<PlannedTask> waiting = {graph.Start()};
  while (!waiting.empty()) {
    const TaskPlace place = waiting.front().place;
    waiting.pop_front();
    const auto start = Clock::now();
    const auto result = RunTask(graph.Spec(place), TaskContext{&*store, [](double) { return true; }, 1});
    (*stages_s)[TaskKindName(place.kind)] += std::chrono::duration<double>(Clock::now() - start).count();
    TREM_CHECK_MSG(result.ok(), result.status().ToString());
    auto planned = graph.Finish(place, {*result, 0, 0});
    TREM_CHECK_MSG(planned.ok(), planned.status().ToString());
    for (PlannedTask& task : *planned) waiting.push_back(std::move(task));
  }
  v1::JobStatus status;
  graph.FillStatus({}, 1, &status);
  for (const v1::ArtefactRef& output : status.outputs()) {
    if (output.name() == "mosaic.tif") return output.sha256();
  }
  return "";
}

// `trem run`, its processes waited for, so that their CPU time counts. Returns the stages' times.
std::map<std::string, double> RunService(const fs::path& sortie, const std::vector<std::string>& overrides, const fs::path& output,
                                         int workers) {
  std::vector<std::string> argv = {testing::BinaryPath("trem").string(),
                                   "run",
                                   sortie.string(),
                                   "-o",
                                   output.string(),
                                   "--workers",
                                   std::to_string(workers),
                                   "--quiet",
                                   "--json"};
  for (const std::string& override_text : overrides) argv.insert(argv.end(), {"--set", override_text});
  const testing::Completed done = testing::RunProgram(argv, std::chrono::hours(2));
  TREM_CHECK_MSG(done.exit_code == 0, done.stderr_text);
  std::map<std::string, double> stages_s;
  const auto report = nlohmann::json::parse(done.stdout_text);
  for (const auto& stage : report.at("stages")) stages_s[stage.at("kind")] = 1e-3 * stage.at("elapsed_ms").get<double>();
  return stages_s;
}

void Print(const char* what, const Cost& cost, const Cost& direct) {
  std::printf("  %-26s %8.2f s, %8.2f s of CPU time; CPU time %+6.1f %%\n", what, cost.wall_s, cost.cpu_s,
              (cost.cpu_s / direct.cpu_s - 1.0) * 100.0);
  std::printf("  %-26s", "");
  for (const char* stage : {"ingest", "enhance", "align", "composite", "export"}) std::printf(" %s %.2f s", stage, cost.stages_s.at(stage));
  std::printf("\n");
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  using namespace trem;
  std::string sortie;
  std::string folder = (fs::temp_directory_path() / ("trem-service-overhead-" + std::to_string(::getpid()))).string();
  std::vector<std::string> overrides;
  int repeats = 1;
  bool skip_direct = false;
  CLI::App app("What the service costs on a real job.", "service_overhead");
  app.add_option("SORTIE", sortie, "A sortie's spec; default: one that is simulated");
  app.add_option("--set", overrides, "A field of the spec")->allow_extra_args(false);
  app.add_option("--repeats", repeats, "Runs of each kind; the fastest counts")->capture_default_str();
  app.add_flag("--skip-direct", skip_direct, "Leave the engine alone out");
  app.add_option("--folder", folder, "Working folder; removed afterwards")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  fs::create_directories(folder);
  if (sortie.empty()) {
    const auto simulated = testing::RunProgram({testing::BinaryPath("trem-worker").string(), "simulate", "-o", folder + "/sortie",
                                                "--quiet", "--width", "320", "--height", "240", "--frames", "60"},
                                               std::chrono::minutes(20));
    TREM_CHECK_MSG(simulated.exit_code == 0, simulated.stderr_text);
    sortie = folder + "/sortie/sortie.textproto";
  }
  auto spec = LoadSortie(sortie, overrides);
  TREM_CHECK_MSG(spec.ok(), spec.status().ToString());
  const Status completed = CompleteSortie(&*spec);
  TREM_CHECK_MSG(completed.ok(), completed.ToString());
  Cost direct, one, two;
  std::string digest;
  for (int round = 0; round < repeats; ++round) {
    const fs::path base = fs::path(folder) / std::to_string(round);
    for (const char* run : {"one", "two"}) fs::create_directories(base / run);
    std::map<std::string, double> stages_s;
    const auto measure = [&](Cost* best, int who, const std::function<void()>& work) {
      Cost cost = Measure(who, work);
      cost.stages_s = std::move(stages_s);
      stages_s.clear();
      if (round == 0 || cost.wall_s < best->wall_s) *best = std::move(cost);
    };
    const auto service = [&](const char* run, int workers) {
      return [&, run, workers] { stages_s = RunService(sortie, overrides, base / run / "mosaic.tif", workers); };
    };
    if (!skip_direct) measure(&direct, RUSAGE_SELF, [&] { digest = RunDirectly(*spec, base / "store", &stages_s); });
    measure(&one, RUSAGE_CHILDREN, service("one", 1));
    measure(&two, RUSAGE_CHILDREN, service("two", 2));
    if (skip_direct) digest = Sha256HexOfFile(base / "one" / "mosaic.tif").value();
    for (const char* run : {"one", "two"}) {
      TREM_CHECK_MSG(Sha256HexOfFile(base / run / "mosaic.tif").value() == digest, "the mosaics differ");
    }
  }
  std::printf("%s\n", sortie.c_str());
  if (!skip_direct) Print("engine in one process", direct, direct);
  Print("trem run --workers 1", one, skip_direct ? one : direct);
  Print("trem run --workers 2", two, skip_direct ? one : direct);
  if (!skip_direct) std::printf("  one worker: %+.1f %% wall time against the engine alone\n", (one.wall_s / direct.wall_s - 1.0) * 100.0);
  std::printf("  two workers: %.2f times as fast as one\n", one.wall_s / two.wall_s);
  fs::remove_all(folder);
  return 0;
}
