#include "worker/app/serve_command.h"
#include "mosaic/base/exit_code.h"

#include <sys/prctl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <iostream>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/log.h"
#include "mosaic/raster/vsi_backing.h"
#include "worker/app/compute_process.h"
#include "worker/app/scratch_folder.h"
#include "worker/app/usage.h"
#include "worker/app/worker_loop.h"
#include "worker/sortie/source_guard.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

struct ServeOptions {
  std::string coordinator;
  std::string store;
  std::string cache;
  std::uint64_t cache_bytes_max = std::uint64_t{20} << 30;
  std::vector<std::string> source_roots;
  std::string key_path;
  std::string coordinator_key_path;
  std::uint64_t memory_bytes_max = 0;
  std::uint32_t processors_max = 0;
  std::uint32_t give_up_s = 0;
  std::uint32_t drain_s = 0;
  std::uint32_t silence_s = 300;
  std::uint32_t task_max_s = 0;
  bool die_with_parent = false;
  std::string log_level = "info";
  std::string log_format = "text";
};

// Read by the signal handler.
std::atomic<bool> stop_requested{false};
std::atomic<const DealerChannel*> signalled_channel{nullptr};

void OnStopSignal(int) {
  stop_requested = true;
  if (const DealerChannel* channel = signalled_channel) channel->Wake();
}

void InstallSignalHandlers() {
  struct sigaction action {};
  action.sa_handler = OnStopSignal;
  ::sigaction(SIGTERM, &action, nullptr);
  ::sigaction(SIGINT, &action, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
}

std::string HostName() {
  std::array<char, 256> name{};
  return ::gethostname(name.data(), name.size() - 1) == 0 && name[0] != '\0' ? std::string(name.data()) : "unknown";
}

// <host>-<pid>-<random>, in the letters that worker ids may have.
std::string NewWorkerId(const std::string& host) {
  constexpr std::size_t kHostLengthMax = 64;
  std::string id = host.substr(0, kHostLengthMax);
  std::transform(id.begin(), id.end(), id.begin(),
                 [](unsigned char c) { return c < 0x80 && std::isalnum(c) != 0 ? static_cast<char>(std::tolower(c)) : '-'; });
  constexpr char kDigits[] = "0123456789abcdef";
  std::random_device random;
  id += "-" + std::to_string(::getpid()) + "-";
  for (int i = 0; i < 8; ++i) id += kDigits[random() % 16];
  return id;
}

// A relative ipc://PATH leads elsewhere once a process has entered the folder of its task store.
std::string AbsoluteEndpoint(const std::string& endpoint) {
  constexpr std::string_view kIpc = "ipc://";
  if (!endpoint.starts_with(kIpc) || endpoint.size() == kIpc.size()) return endpoint;
  return std::string(kIpc) + fs::absolute(endpoint.substr(kIpc.size())).string();
}

// On the disk of the store or the cache: files of sorties are hard links to objects there.
fs::path ScratchParent(const ServeOptions& serve) {
  if (!serve.store.empty() && !IsVsiPath(serve.store)) return fs::path(serve.store) / "tmp";
  std::error_code ignored;
  return serve.cache.empty() ? fs::temp_directory_path(ignored) : fs::path(serve.cache) / "tmp";
}

ComputeProcessOptions ComputeOptionsOf(const ServeOptions& serve, const fs::path& scratch) {
  ComputeProcessOptions options;
  // By /proc, so that a worker whose program is replaced while it runs goes on with the one that it is.
  options.argv = {"/proc/self/exe",     "compute",
                  "--memory-max-bytes", std::to_string(serve.memory_bytes_max),
                  "--log-level",        serve.log_level,
                  "--log-format",       serve.log_format,
                  "--cache-bytes-max",  std::to_string(serve.cache_bytes_max),
                  "--coordinator",      AbsoluteEndpoint(serve.coordinator),
                  "--scratch",          scratch.string()};
  const std::pair<const char*, const std::string*> paths[] = {
      {"--store", &serve.store}, {"--cache", &serve.cache}, {"--key", &serve.key_path}, {"--coordinator-key", &serve.coordinator_key_path}};
  for (const auto& [name, path] : paths) {
    if (!path->empty()) options.argv.insert(options.argv.end(), {name, *path});
  }
  options.silence_max = std::chrono::seconds(serve.silence_s);
  options.task_max = std::chrono::seconds(serve.task_max_s);
  return options;
}

Status Serve(ServeOptions serve) {
  if (!serve.store.empty()) {
    // Before any task fails by it.
    TREM_RETURN_IF_ERROR(IsVsiPath(serve.store) ? VsiBacking(serve.store).Check() : ArtefactStore::Open(serve.store).status());
  }
  TREM_ASSIGN_OR_RETURN(const ScratchFolder scratch, ScratchFolder::Make(ScratchParent(serve)));
  if (serve.cache.empty()) serve.cache = (scratch.path() / "cache").string();
  WorkerOptions options;
  options.host = HostName();
  options.pid = static_cast<std::uint32_t>(::getpid());
  options.worker_id = NewWorkerId(options.host);
  options.memory_bytes_max = serve.memory_bytes_max;
  options.give_up = std::chrono::seconds(serve.give_up_s);
  options.drain_grace = std::chrono::seconds(serve.drain_s);
  TREM_ASSIGN_OR_RETURN(const ChannelOptions channel_options, ChannelOptionsOf(serve.key_path, serve.coordinator_key_path));
  TREM_ASSIGN_OR_RETURN(const SourceGuard guard, SourceGuard::Make(serve.source_roots, /*closed=*/!serve.key_path.empty()));
  AttemptLog log;
  options.log = &log;
  ComputeProcessOptions compute_options = ComputeOptionsOf(serve, scratch.path());
  compute_options.on_stderr = [&log](std::string_view bytes) { log.Add(bytes); };
  ComputeProcess compute(std::move(compute_options));
  compute.Start();
  TREM_ASSIGN_OR_RETURN(const auto channel, DealerChannel::Connect(serve.coordinator, channel_options));
  signalled_channel = channel.get();
  options.on_share = [&](int processors) {
    compute.SetProcessors(serve.processors_max > 0 ? std::min(processors, static_cast<int>(serve.processors_max)) : processors);
  };
  const auto task = [&](const v1::TaskSpec& spec, const std::function<bool(double)>& progress) -> TaskOutcome {
    TREM_RETURN_IF_ERROR(guard.Check(spec.sortie()));
    return compute.Run(spec, progress);
  };
  const Status status = RunWorkerLoop(options, channel.get(), task, stop_requested);
  signalled_channel = nullptr;
  return status;
}

}  // namespace

int RunServeCommand(int argc, char** argv) {
  ServeOptions options;
  CLI::App app("Joins a coordinator and computes its tasks, one at a time, until SIGTERM or SIGINT.", "trem-worker serve");
  app.footer(
      "Example:\n  trem-worker serve --coordinator ipc:///run/trem/socket --store /srv/trem/store\n\n"
      "Exit codes: 0 stopped by a signal; 2 usage; 3 refused by the coordinator or invalid option; 4 coordinator not reachable;\n"
      "9 a cancelled task did not stop; 1 other failures.");
  app.add_option("--coordinator", options.coordinator, "Endpoint of the coordinator: ipc://PATH or tcp://HOST:PORT")->required();
  app.add_option("--source-root", options.source_roots,
                 "Read sorties below this folder only; may be repeated. Default: everything without --key, nothing with it")
      ->allow_extra_args(false);
  app.add_option("--key", options.key_path, "Secret key file of this worker (`trem keys`); needed beyond this machine")
      ->envname("TREM_KEY");
  app.add_option("--coordinator-key", options.coordinator_key_path, "The coordinator's .pub file")->envname("TREM_COORDINATOR_KEY");
  app.add_option(
      "--store", options.store,
      "Artefact store, the same as the coordinator's: a shared folder, or /vsis3/BUCKET/PREFIX. Default: artefacts are streamed");
  app.add_option("--cache", options.cache,
                 "Folder for artefacts that are not in a shared folder; the workers of a machine may share it. Default: a "
                 "temporary one");
  app.add_option("--cache-bytes-max", options.cache_bytes_max, "The least recently used artefacts of the cache are removed beyond this")
      ->capture_default_str();
  app.add_option("--memory-max-bytes", options.memory_bytes_max,
                 "Take no task that needs more memory, and let none allocate more (0: no limit)")
      ->capture_default_str();
  app.add_option("--processors-max", options.processors_max,
                 "Use at most so many processors, its own and those that idle workers of this host lend it (0: as many as are lent)")
      ->check(CLI::Range(0U, 4096U))
      ->capture_default_str();
  app.add_option("--give-up-s", options.give_up_s, "Exit after the coordinator was silent for so many seconds (0: never)")
      ->capture_default_str();
  app.add_option("--drain-s", options.drain_s, "Told to stop, let the running task go on for so many seconds before handing it back")
      ->capture_default_str();
  app.add_option("--silence-max-s", options.silence_s, "Kill a task that reports no progress for so many seconds")
      ->check(CLI::Range(1U, 86'400U))
      ->capture_default_str();
  app.add_option("--task-max-s", options.task_max_s, "Kill a task that takes more seconds (0: no limit)")->capture_default_str();
  app.add_flag("--die-with-parent", options.die_with_parent, "Stop when the process that started this one dies");
  app.add_option("--log-level", options.log_level, "trace, debug, info, warn, error or off")->capture_default_str();
  app.add_option("--log-format", options.log_format, "text, or json: one object a line")->check(CLI::IsMember({"text", "json"}));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  if (const Status configured = ConfigureLog("trem-worker " + std::to_string(::getpid()), options.log_level, options.log_format);
      !configured.ok()) {
    std::cerr << "trem-worker: " << configured.message() << "\n";
    return kExitUsage;
  }
  InstallSignalHandlers();
  if (options.die_with_parent) {
    const pid_t parent = ::getppid();
    ::prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (::getppid() != parent) return 0;  // It died before it could be watched.
  }
  const Status status = Serve(options);
  if (!status.ok()) std::cerr << "trem-worker: " << status.message() << "\n";
  return ExitCodeOf(status);
}

}  // namespace trem
