// A worker as trem-worker's `serve` is one (the real loop, a real compute process), whose tasks do nothing: for service_throughput.
#include <sys/prctl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <string>

#include "mosaic/base/log.h"
#include "proto/channel/dealer_channel.h"
#include "tests/bench/no_op_task.h"
#include "worker/app/compute_process.h"
#include "worker/app/worker_loop.h"

namespace {

std::atomic<bool> stop_requested{false};
std::atomic<const trem::DealerChannel*> channel_to_wake{nullptr};

void OnStopSignal(int) {
  stop_requested = true;
  if (const trem::DealerChannel* channel = channel_to_wake.load()) channel->Wake();
}

int Serve(const std::string& coordinator, std::uint32_t windows) {
  auto channel = trem::DealerChannel::Connect(coordinator);
  if (!channel.ok()) {
    std::cerr << channel.status().message() << "\n";
    return 1;
  }
  channel_to_wake = channel->get();
  trem::WorkerOptions options;
  options.worker_id = "no-op-" + std::to_string(::getpid());
  options.host = "bench";
  trem::ComputeProcessOptions compute_options;
  compute_options.argv = {"/proc/self/exe", "--windows", std::to_string(windows)};
  trem::AttemptLog log;
  options.log = &log;
  compute_options.on_stderr = [&log](std::string_view bytes) { log.Add(bytes); };
  trem::ComputeProcess compute(compute_options);
  const trem::Status status = trem::RunWorkerLoop(
      options, channel->get(),
      [&](const trem::v1::TaskSpec& spec, const std::function<bool(double)>& progress) { return compute.Run(spec, progress); },
      stop_requested);
  channel_to_wake = nullptr;
  if (!status.ok()) std::cerr << status.message() << "\n";
  return status.ok() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  std::string coordinator;
  std::uint32_t windows = 1000;
  int fd = -1;
  CLI::App app("A worker whose tasks do nothing.", "no_op_worker");
  app.add_option("--coordinator", coordinator, "Endpoint");
  app.add_option("--windows", windows, "Of a job")->capture_default_str();
  app.add_option("--fd", fd, "Compute for the process at the other end");
  CLI11_PARSE(app, argc, argv);
  if (fd >= 0) {
    std::signal(SIGTERM, SIG_IGN);
    trem::ServeCompute(fd, [windows](const trem::v1::TaskSpec& spec, const std::function<bool(double)>&) -> trem::TaskOutcome {
      return trem::bench::NoOpResult(spec, windows);
    });
  }
  (void)trem::ConfigureLog("no_op_worker", "warn").ok();
  std::signal(SIGTERM, OnStopSignal);
  ::prctl(PR_SET_PDEATHSIG, SIGTERM);  // A measurement that breaks off leaves nothing behind.
  return Serve(coordinator, windows);
}
