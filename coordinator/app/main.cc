// trem-coordinator: binds the endpoint, opens the log, and turns messages into events until it is told to stop.
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <exception>
#include <iostream>
#include <memory>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "coordinator/app/gate.h"
#include "coordinator/app/monitoring.h"
#include "coordinator/app/restore_command.h"
#include "coordinator/app/shell.h"
#include "coordinator/data/artefact_server.h"
#include "coordinator/data/garbage_collector.h"
#include "mosaic/base/exit_code.h"
#include "mosaic/base/file.h"
#include "mosaic/base/log.h"
#include "mosaic/base/wall_clock.h"
#include "proto/channel/router_channel.h"

namespace trem {
namespace {

// Log writes are shared by messages that came in together, up to this many.
constexpr int kBatchMax = 256;
constexpr TimeMs kTickIntervalMs = 100;
// When messages never cease, leases and lost workers are looked at this often all the same.
constexpr TimeMs kTickIntervalBusyMs = 2'000;

std::atomic<bool> stop_requested{false};
std::atomic<const RouterChannel*> channel_to_wake{nullptr};

void OnStopSignal(int) {
  stop_requested = true;
  if (const RouterChannel* channel = channel_to_wake.load()) channel->Wake();
}

struct CommandLine {
  std::string state_folder;
  std::string store_folder;
  std::string endpoint;
  std::string data_endpoint;
  ArtefactServerOptions data;
  std::string ready_file;
  std::string backup_folder;
  std::string key_path;
  std::string allow_folder;
  int connections_max = 4096;
  std::string log_level = "info";
  std::string log_format = "text";
  HttpServerOptions http;  // No address: none.
  bool die_with_parent = false;
  ShellOptions shell;
};

void Describe(CLI::App* app, CommandLine* options) {
  app->add_option("--state", options->state_folder, "Folder of the event log; created when missing")->required();
  app->add_option("--store", options->store_folder,
                  "Folder of the artefact store; or /vsis3/BUCKET/PREFIX, where the workers keep artefacts")
      ->required();
  app->add_option("--bind", options->endpoint,
                  "Endpoint: ipc:///path or tcp://127.0.0.1:PORT (PORT * takes a free one); with --key any address, tcp://*:PORT")
      ->required();
  app->add_option(
      "--data-bind", options->data_endpoint,
      "Endpoint of the data lane, for workers and clients that do not share the store; none: no such lane. Default: beside --bind, "
      "on any free port");
  app->add_option(
         "--store-bytes-max", options->data.store_bytes_max,
         "Limit of the artefact store: what would make it larger is refused on the data lane, and new jobs while it is larger (0: none)")
      ->capture_default_str();
  app->add_option("--key", options->key_path,
                  "Secret key file of this coordinator (`trem keys`); then only peers with an allowed key get in");
  app->add_option("--allow", options->allow_folder, "Folder of the .pub files of all keys that are let in; changes take effect at once");
  app->add_option("--connections-max", options->connections_max, "Further connections are closed")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app->add_option("--backups", options->backup_folder, "Folder for what `trem backup` makes; default: backups in --state");
  app->add_option("--job-log-bytes-max", options->shell.job_log.job_bytes_max, "What `trem logs` keeps of a job")
      ->check(CLI::Range(65'536UL, 64UL << 20))
      ->capture_default_str();
  app->add_option("--logs-bytes-max", options->shell.job_log.bytes_max, "What it keeps of all jobs together")->capture_default_str();
  app->add_option("--ready-file", options->ready_file,
                  "Write the endpoint, with its real port, and the --http address to this file once bound");
  app->add_option("--log-level", options->log_level, "trace, debug, info, warn, error or off")->capture_default_str();
  app->add_option("--log-format", options->log_format, "text, or json: one object a line")->check(CLI::IsMember({"text", "json"}));
  app->add_option("--http", options->http.address, "Serve /metrics, /healthz and /readyz here, for example 127.0.0.1:9411 (port 0: any)");
  app->add_flag("--http-open", options->http.open, "Accept an --http address that other machines reach; there are no keys on that lane");
  app->add_flag("--die-with-parent", options->die_with_parent, "Stop when the process that started this one ends");
  app->add_option("--lease-ms", options->shell.scheduler.lease_ms, "A task without progress for this long goes to another worker")
      ->check(CLI::Range(100U, 86'400'000U))
      ->capture_default_str();
  app->add_option("--heartbeat-ms", options->shell.heartbeat_interval_ms, "Interval of heartbeats; a worker silent for 8 of them is lost")
      ->check(CLI::Range(10U, 60'000U))
      ->capture_default_str();
  app->add_option("--user-jobs-max", options->shell.user_jobs_max, "Jobs that one user may have running; more are refused (0: no limit)")
      ->capture_default_str();
  app->add_option("--user-tasks-max", options->shell.scheduler.user_tasks_max,
                  "Tasks that one user may have running at once; more wait (0: no limit)")
      ->capture_default_str();
  app->add_option("--outages-max", options->shell.scheduler.outages_max,
                  "A task that finds a disk full or a mount gone so often is given up; waits between attempts grow to a minute")
      ->check(CLI::Range(1U, 1000U))
      ->capture_default_str();
  app->add_option("--hedge-factor", options->shell.scheduler.hedge_factor,
                  "A task that takes so many times its stage's mean gets a second attempt on an idle worker (0: never)")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app->footer(
      "'trem-coordinator restore --help': putting a backup back.\n\n"
      "Examples:\n  trem-coordinator --state /var/lib/trem/state --store /srv/trem/store --bind tcp://127.0.0.1:7411\n"
      "  trem-coordinator --state /var/lib/trem/state --store /srv/trem/store --bind 'tcp://*:7411' --key coordinator.key --allow "
      "allowed/");
}

// PR_SET_PDEATHSIG asks for SIGTERM when the parent ends; a parent that ended before that is noticed by its changed id.
Status TieToParent(pid_t parent) {
  if (prctl(PR_SET_PDEATHSIG, SIGTERM) != 0) return FromErrno("prctl(PR_SET_PDEATHSIG)", errno);
  if (getppid() != parent) return Cancelled("the process that started this one has ended");
  return {};
}

TimeMs NowMs() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// As many descriptors as the system allows: every connection takes one.
int RaiseDescriptorLimit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return 1024;
  limit.rlim_cur = limit.rlim_max;
  (void)::setrlimit(RLIMIT_NOFILE, &limit);
  (void)::getrlimit(RLIMIT_NOFILE, &limit);
  return static_cast<int>(std::min<rlim_t>(limit.rlim_cur, 1'000'000));
}

Result<ChannelOptions> MakeChannelOptions(const CommandLine& options) {
  constexpr int kOwnDescriptors = 128;
  ChannelOptions channel;
  channel.connections_max = std::max(1, std::min(options.connections_max, RaiseDescriptorLimit() - kOwnDescriptors));
  if (options.key_path.empty() != options.allow_folder.empty()) return InvalidInput("--key and --allow belong together");
  if (options.key_path.empty()) return channel;
  TREM_ASSIGN_OR_RETURN(channel.own_key, ReadSecretKey(options.key_path));
  if (channel.own_key->role() != v1::COORDINATOR) {
    return InvalidInput("key file " + options.key_path + " has the role " + RoleName(channel.own_key->role()) + "; expected coordinator");
  }
  TREM_ASSIGN_OR_RETURN(channel.allow_list, AllowList::Open(options.allow_folder));
  return channel;
}

// The data lane; null when there is to be none.
Result<std::unique_ptr<ArtefactServer>> StartDataLane(const CommandLine& options, const ChannelOptions& channel_options,
                                                      const ArtefactStore& artefacts) {
  std::string endpoint = options.data_endpoint;
  if (endpoint == "none" || options.store_folder.starts_with("/vsi")) return std::unique_ptr<ArtefactServer>();
  if (endpoint.empty()) {
    const bool is_file = options.endpoint.starts_with("ipc://");
    endpoint = is_file ? options.endpoint + ".data" : options.endpoint.substr(0, options.endpoint.rfind(':')) + ":*";
  }
  auto server = ArtefactServer::Start(endpoint, channel_options, artefacts, options.data);
  if (!server.ok()) return server.status().WithPrefix("--data-bind");
  spdlog::info("data lane on {}", (*server)->endpoint());
  return server;
}

// Where the data lane is, for those who ask.
v1::Envelope DataLaneAnswer(const ArtefactServer* data_lane) {
  v1::Envelope answer;
  if (data_lane != nullptr) {
    answer.mutable_data_lane()->set_endpoint(data_lane->endpoint());
  } else {
    answer.mutable_error()->set_status_code(static_cast<std::uint32_t>(StatusCode::kInvalidInput));
    answer.mutable_error()->set_message(
        "this coordinator has no data lane (--data-bind none, or the store is an object store): name its store with --store");
  }
  return answer;
}

// A random name that the state folder keeps: what is in an object store is known by it.
Result<std::string> IdOf(const std::filesystem::path& state_folder) {
  const std::filesystem::path path = state_folder / "id";
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    std::random_device random;
    TREM_RETURN_IF_ERROR(WriteFileAtomically(path, fmt::format("{:08x}{:08x}{:08x}\n", random(), random(), random())));
  }
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, 256));
  return text.substr(0, text.find('\n'));
}

// Whether what is in the store is this coordinator's to judge. The first one to use a store leaves its state folder's name in it: another's
// log knows nothing of what the first one's jobs have.
bool OwnsStore(const ArtefactStore& artefacts, const std::filesystem::path& state_folder) {
  constexpr std::uint64_t kNoteBytesMax = 8192;
  const std::filesystem::path note = artefacts.root() / "owner";
  const std::string self = state_folder.string() + "\n";
  std::error_code error;
  const bool is_new = !std::filesystem::exists(note, error);
  const Status written = is_new ? WriteFileAtomically(note, self) : Status();
  const Result<std::string> owner = written.ok() ? ReadFile(note, kNoteBytesMax) : Result<std::string>(written);
  if (owner.ok() && *owner == self) return true;
  spdlog::warn("the artefact store {} is not swept: {}", artefacts.root().string(),
               owner.ok()
                   ? "it belongs to the coordinator of another state folder, says " + note.string() + "; remove that file if it does not"
                   : owner.status().message());
  return false;
}

// Sweeps the store now and then, and after a job was removed.
class StoreKeeper {
 public:
  StoreKeeper(const CommandLine& options, const ArtefactStore& artefacts, ArtefactServer* data_lane)
      : bytes_max_(options.data.store_bytes_max), data_lane_(data_lane), collector_(artefacts, {}) {}

  void Tend(TimeMs now_ms, Shell* shell) {
    if (std::vector<std::string> released = shell->TakeReleased(); !released.empty()) {
      released_.insert(released_.end(), released.begin(), released.end());
      next_ms_ = std::min(next_ms_, now_ms + kSweepDelayMs);
      has_released_ = true;
    }
    if (now_ms >= next_ms_) {
      // What was too young to be removed with its job is old enough soon.
      next_ms_ = now_ms + (has_released_ ? kSweepAgainMs : kSweepIntervalMs);
      has_released_ = false;
      Result<std::vector<std::string>> in_use = shell->ArtefactsInUse();
      if (in_use.ok()) {
        collector_.Begin(*std::move(in_use), std::exchange(released_, {}));
      } else {
        spdlog::warn("the artefact store is not swept: {}", in_use.status().message());
      }
    }
    const auto report = collector_.TakeReport();
    if (!report) return;
    if (data_lane_ != nullptr) data_lane_->set_store_bytes(report->bytes);
    shell->NoteStoreBytes(report->bytes);
    const bool is_over = bytes_max_ > 0 && report->bytes > bytes_max_;
    shell->RefuseJobs(is_over ? fmt::format("the artefact store holds {} of at most {} bytes; remove jobs that are not needed any more "
                                            "(trem remove), or raise --store-bytes-max",
                                            report->bytes, bytes_max_)
                              : "");
  }

 private:
  static constexpr TimeMs kSweepIntervalMs = 3'600'000;
  static constexpr TimeMs kSweepAgainMs = 120'000;
  static constexpr TimeMs kSweepDelayMs = 1000;  // Several jobs are often removed one after the other.

  std::uint64_t bytes_max_;
  ArtefactServer* data_lane_;
  TimeMs next_ms_ = 0;
  bool has_released_ = false;
  std::vector<std::string> released_;
  GarbageCollector collector_;
};

// With keys, whose share of the workers a job uses is not for the client to say.
void SetUser(const std::string& user, v1::Envelope* envelope) {
  if (envelope->has_submit_job()) envelope->mutable_submit_job()->set_user(user);
  if (envelope->has_get_service_report()) envelope->mutable_get_service_report()->set_user(user);
}

Status Serve(const ArtefactServer* data_lane, StoreKeeper* keeper, RouterChannel* channel, Gate* gate, Shell* shell,
             Monitoring* monitoring) {
  TimeMs last_tick_ms = 0;
  bool is_busy = false;  // There is something to go on with when nobody asks for anything.
  while (!stop_requested && !shell->shutdown_requested()) {
    bool drained = false;
    for (int i = 0; i < kBatchMax && !drained; ++i) {
      auto incoming = channel->Poll(std::chrono::milliseconds(i == 0 && !is_busy ? kTickIntervalMs : 0));
      drained = !incoming.has_value();
      if (drained) break;
      const TimeMs arrived_ms = NowMs();
      if (incoming->envelope.ok() && !incoming->user.empty()) SetUser(incoming->user, &*incoming->envelope);
      if (const Status admitted = gate->Admit(arrived_ms, *incoming); admitted.ok() && incoming->envelope->has_get_data_lane()) {
        channel->Send(incoming->peer, DataLaneAnswer(data_lane));
      } else if (admitted.ok()) {
        shell->Receive(arrived_ms, incoming->peer, *incoming->envelope);
      } else if (!gate->MayAnswer(arrived_ms, incoming->peer)) {
        continue;
      } else if (incoming->other_release && MaySend(incoming->role, v1::Envelope::kHello)) {
        v1::Envelope hello;  // Refused by the shell, which remembers who it was.
        *hello.mutable_hello() = *std::move(incoming->other_release);
        shell->Receive(arrived_ms, incoming->peer, hello);
      } else {
        shell->ReceiveBroken(incoming->peer, admitted);
      }
    }
    const TimeMs now_ms = NowMs();
    const TimeMs since_tick_ms = now_ms - last_tick_ms;
    if (since_tick_ms >= kTickIntervalBusyMs || (drained && since_tick_ms >= kTickIntervalMs)) {
      shell->Tick(now_ms);
      last_tick_ms = now_ms;
    }
    monitoring->BeginCommit();
    TREM_RETURN_IF_ERROR(shell->Flush());
    is_busy = shell->Maintain();
    if (keeper != nullptr) keeper->Tend(now_ms, shell);
    monitoring->Observe(now_ms, *channel, *gate, data_lane, *shell);
  }
  return {};
}

Status RunCoordinator(const CommandLine& options, pid_t parent) {
  if (options.die_with_parent) TREM_RETURN_IF_ERROR(TieToParent(parent));
  TREM_ASSIGN_OR_RETURN(const ChannelOptions channel_options, MakeChannelOptions(options));
  const bool is_elsewhere = options.store_folder.starts_with("/vsi");
  // Then nothing is ever put into this one.
  const std::string store_folder = is_elsewhere ? options.state_folder + "/no-artefacts" : options.store_folder;
  TREM_ASSIGN_OR_RETURN(ArtefactStore artefacts, ArtefactStore::Open(std::filesystem::absolute(store_folder).lexically_normal()));
  TREM_ASSIGN_OR_RETURN(std::unique_ptr<EventStore> events,
                        EventStore::Open(std::filesystem::absolute(options.state_folder).lexically_normal()));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<ArtefactServer> data_lane, StartDataLane(options, channel_options, artefacts));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<Monitoring> monitoring, Monitoring::Start(options.http));
  ShellOptions shell_options = options.shell;
  if (is_elsewhere) shell_options.store_elsewhere = options.store_folder;
  const std::filesystem::path state_folder = std::filesystem::absolute(options.state_folder).lexically_normal();
  shell_options.job_log_folder = state_folder / "logs";
  TREM_ASSIGN_OR_RETURN(shell_options.state_id, IdOf(state_folder));
  // A store elsewhere is swept from where its credentials are: `trem sweep`.
  const bool is_own = !is_elsewhere && OwnsStore(artefacts, state_folder);
  const auto keeper = is_own ? std::make_unique<StoreKeeper>(options, artefacts, data_lane.get()) : nullptr;
  shell_options.backup_folder = options.backup_folder.empty() ? state_folder / "backups" : std::filesystem::absolute(options.backup_folder);
  shell_options.wall_clock_ms = WallClockMs;
  shell_options.store_bytes_max = options.data.store_bytes_max;
  shell_options.on_logged = [&](std::span<const v1::LogEvent> logged) { monitoring->EndCommit(logged); };
  // Bound after the log was read: until then peers see nobody and queue nothing.
  std::unique_ptr<RouterChannel> channel;
  TREM_ASSIGN_OR_RETURN(
      const std::unique_ptr<Shell> shell,
      Shell::Create(std::move(events), std::move(artefacts), shell_options,
                    [&channel](const std::string& peer, const v1::Envelope& envelope) { return channel->Send(peer, envelope); }));
  TREM_ASSIGN_OR_RETURN(channel, RouterChannel::Bind(options.endpoint, channel_options));
  channel_to_wake = channel.get();
  Gate gate;
  spdlog::info("listening on {}", channel->endpoint());
  Status status;
  monitoring->BecomeReady();
  if (!options.ready_file.empty()) status = WriteFileAtomically(options.ready_file, channel->endpoint() + "\n" + monitoring->url() + "\n");
  if (status.ok()) status = Serve(data_lane.get(), keeper.get(), channel.get(), &gate, shell.get(), monitoring.get());
  channel_to_wake = nullptr;
  if (status.ok()) spdlog::info("stopped; everything that was acknowledged is in the log");
  return status;
}

int Main(int argc, char** argv) {
  if (argc > 1 && std::string_view(argv[1]) == "restore") return RunRestoreCommand(argc - 1, argv + 1);
  const pid_t parent = getppid();
  CLI::App app{"Hands the tasks of mapping jobs to trem workers and keeps what they found.", "trem-coordinator"};
  app.set_version_flag("--version", TREM_VERSION);
  CommandLine options;
  Describe(&app, &options);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kExitDone : kExitUsage;
  }
  if (const Status configured = ConfigureLog("trem-coordinator", options.log_level, options.log_format); !configured.ok()) {
    std::cerr << "trem-coordinator: " << configured.message() << '\n';
    return kExitUsage;
  }
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGTERM, OnStopSignal);
  std::signal(SIGINT, OnStopSignal);
  const Status status = RunCoordinator(options, parent);
  if (!status.ok()) spdlog::error("{}", status.message());
  return ExitCodeOf(status);
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  try {
    return trem::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "trem-coordinator: " << error.what() << '\n';
    return 1;
  }
}
