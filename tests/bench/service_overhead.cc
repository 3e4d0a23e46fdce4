// Question: what does the service cost on a real job: against the engine called task by task in one process, and what do two workers gain
// over one? Prints wall and CPU time of the job run directly, by `trem run --workers 1` and by `trem run --workers 2`, and their ratios.
//
// Baseline: the direct run does the same tasks in the order of the plan, with the same artefact store (every result hashed, synced and
// renamed), and without log, messages and processes. Aims: at most 10 % more CPU time with one worker; two workers on two cores at
// least 1.8 times as fast. The mosaics of all runs must be the same bytes.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <string>
#include <vector>

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
  return {std::chrono::duration<double>(Clock::now() - start).count(), CpuSeconds(who) - cpu};
}

// All tasks of the job, one after the other. Returns the digest of the mosaic.
std::string RunDirectly(const v1::Sortie& sortie, const fs::path& folder) {
  const auto store = ArtefactStore::Open(folder);
  TREM_CHECK_MSG(store.ok(), store.status().ToString());
  JobGraph graph("direct", sortie);
  std::deque<PlannedTask> waiting = {graph.Start()};
  while (!waiting.empty()) {
    const TaskPlace place = waiting.front().place;
    waiting.pop_front();
    const auto result = RunTask(graph.Spec(place), TaskContext{&*store, [](double) { return true; }});
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

// `trem run`, its processes waited for, so that their CPU time counts.
void RunService(const fs::path& sortie, const std::vector<std::string>& overrides, const fs::path& output, int workers) {
  std::vector<std::string> argv = {
      testing::BinaryPath("trem").string(), "run", sortie.string(), "-o", output.string(), "--workers", std::to_string(workers), "--quiet"};
  for (const std::string& override_text : overrides) argv.insert(argv.end(), {"--set", override_text});
  const testing::Completed done = testing::RunProgram(argv, std::chrono::hours(2));
  TREM_CHECK_MSG(done.exit_code == 0, done.stderr_text);
}

void Print(const char* what, const Cost& cost, const Cost& direct) {
  std::printf("  %-26s %8.2f s, %8.2f s of CPU time; CPU time %+6.1f %%\n", what, cost.wall_s, cost.cpu_s,
              (cost.cpu_s / direct.cpu_s - 1.0) * 100.0);
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  using namespace trem;
  std::string sortie;
  std::string folder = (fs::temp_directory_path() / ("trem-service-overhead-" + std::to_string(::getpid()))).string();
  std::vector<std::string> overrides;
  int repeats = 1;
  CLI::App app("What the service costs on a real job.", "service_overhead");
  app.add_option("SORTIE", sortie, "A sortie's spec; default: one that is simulated");
  app.add_option("--set", overrides, "A field of the spec")->allow_extra_args(false);
  app.add_option("--repeats", repeats, "Runs of each kind; the fastest counts")->capture_default_str();
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
  const auto better = [](Cost* best, const Cost& cost, int round) {
    if (round == 0 || cost.cpu_s < best->cpu_s) *best = cost;
  };
  Cost direct, one, two;
  std::string digest;
  for (int round = 0; round < repeats; ++round) {
    const fs::path base = fs::path(folder) / std::to_string(round);
    for (const char* run : {"one", "two"}) fs::create_directories(base / run);
    better(&direct, Measure(RUSAGE_SELF, [&] { digest = RunDirectly(*spec, base / "store"); }), round);
    better(&one, Measure(RUSAGE_CHILDREN, [&] { RunService(sortie, overrides, base / "one" / "mosaic.tif", 1); }), round);
    better(&two, Measure(RUSAGE_CHILDREN, [&] { RunService(sortie, overrides, base / "two" / "mosaic.tif", 2); }), round);
    for (const char* run : {"one", "two"}) {
      TREM_CHECK_MSG(Sha256HexOfFile(base / run / "mosaic.tif").value() == digest, "the mosaics differ");
    }
  }
  std::printf("%s\n", sortie.c_str());
  Print("engine in one process", direct, direct);
  Print("trem run --workers 1", one, direct);
  Print("trem run --workers 2", two, direct);
  std::printf("  one worker: %+.1f %% wall time against the engine alone; two workers: %.2f times as fast as one\n",
              (one.wall_s / direct.wall_s - 1.0) * 100.0, one.wall_s / two.wall_s);
  fs::remove_all(folder);
  return 0;
}
