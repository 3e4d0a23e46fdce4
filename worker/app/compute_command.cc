#include "worker/app/compute_command.h"

#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <fstream>
#include <iostream>
#include <string>

#include "mosaic/base/exit_code.h"
#include "mosaic/base/log.h"
#include "worker/app/compute_protocol.h"
#include "worker/app/task_store.h"
#include "worker/app/usage.h"
#include "worker/tasks/bad_artefacts.h"

namespace trem {
namespace {

// Limits what the process may take before its allocations fail, and offers it to the kernel before others when memory runs out all the
// same.
void LimitMemory(std::uint64_t memory_bytes_max) {
  if (memory_bytes_max > 0) {
    const rlimit limit{memory_bytes_max, memory_bytes_max};
    if (::setrlimit(RLIMIT_DATA, &limit) != 0) spdlog::warn("the memory limit cannot be set");
  }
  const rlimit no_core{0, 0};
  (void)::setrlimit(RLIMIT_CORE, &no_core);
  std::ofstream("/proc/self/oom_score_adj") << "500\n";
}

}  // namespace

int RunComputeCommand(int argc, char** argv) {
  TaskStoreOptions store_options;
  std::string key_path, coordinator_key_path;
  std::string log_level = "info";
  std::string log_format = "text";
  std::uint64_t memory_bytes_max = 0;
  int fd = -1;
  CLI::App app("Computes tasks for the 'trem-worker serve' that started it.", "trem-worker compute");
  app.add_option("--store", store_options.store,
                 "Artefact store: a folder or one of GDAL's virtual paths; default: artefacts are streamed");
  app.add_option("--cache", store_options.cache, "Folder for artefacts that are not in a folder");
  app.add_option("--cache-bytes-max", store_options.cache_bytes_max, "Limit of what is kept in the cache");
  app.add_option("--scratch", store_options.scratch, "Folder for the files of sorties")->required();
  app.add_option("--coordinator", store_options.coordinator, "Endpoint of the coordinator");
  app.add_option("--key", key_path, "Secret key file of this worker");
  app.add_option("--coordinator-key", coordinator_key_path, "The coordinator's .pub file");
  app.add_option("--memory-max-bytes", memory_bytes_max, "Allocations beyond this fail (0: no limit)");
  app.add_option("--fd", fd, "Socket to the process that started this one")->required();
  app.add_option("--log-level", log_level, "trace, debug, info, warn, error or off");
  app.add_option("--log-format", log_format, "text or json");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  if (const Status configured = ConfigureLog("trem-worker " + std::to_string(::getpid()), log_level, log_format); !configured.ok()) {
    std::cerr << "trem-worker: " << configured.message() << "\n";
    return kExitUsage;
  }
  // Ctrl-C reaches the whole group; the parent decides what becomes of the task.
  for (const int ignored : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) ::signal(ignored, SIG_IGN);
  LimitMemory(memory_bytes_max);
  const Result<ChannelOptions> channel_options = ChannelOptionsOf(key_path, coordinator_key_path);
  auto store = channel_options.ok() ? TaskStore::Open(store_options, *channel_options) : Result<TaskStore>(channel_options.status());
  if (!store.ok()) {
    std::cerr << "trem-worker: " << store.status().message() << "\n";
    return ExitCodeOf(store.status());
  }
  ServeCompute(fd, [&store](const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
    TaskOutcome outcome = store->Run(spec, progress);
    if (!outcome.result.ok()) outcome.bad_artefacts = FindBadArtefacts(spec, outcome.result.status(), store->store());
    return outcome;
  });
}

}  // namespace trem
