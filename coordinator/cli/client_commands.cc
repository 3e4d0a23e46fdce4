#include "coordinator/cli/client_commands.h"

#include <fmt/format.h>

#include <cctype>
#include <memory>
#include <optional>
#include <random>
#include <thread>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/client.h"
#include "coordinator/cli/interrupt.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/outputs.h"
#include "coordinator/cli/progress.h"
#include "coordinator/cli/remote.h"
#include "coordinator/cli/terminal.h"
#include "coordinator/cli/upload.h"
#include "proto/channel/artefact_channel.h"
#include "proto/codec/envelope.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using nlohmann::ordered_json;

constexpr std::chrono::milliseconds kPollInterval{500};
constexpr std::size_t kWarningLinesMax = 10;
constexpr std::size_t kJobIdNameMax = 40;

// "<name in lower case>-<8 random hexadecimal digits>".
std::string NewJobId(const std::string& name) {
  std::string id;
  for (const char c : name.substr(0, kJobIdNameMax)) {
    const auto byte = static_cast<unsigned char>(c);
    const bool plain = byte < 0x80 && std::isalnum(byte) != 0;
    if (plain) {
      id += static_cast<char>(std::tolower(byte));
    } else if (!id.empty() && id.back() != '-') {
      id += '-';
    }
  }
  if (id.empty()) id = "job-";
  if (id.back() != '-') id += '-';
  return id + fmt::format("{:08x}", std::random_device{}());
}

void PrintJob(const v1::JobStatus& job) {
  fmt::print("{}  {}  {}\n", job.job_id(), JobStateName(job.state()), job.name());
  if (!job.error().empty()) fmt::print("  error: {}\n", job.error());
  for (const v1::StageStatus& stage : job.stages()) {
    fmt::print("  {:<10} {:>7} of {:<7} done, {} running\n", TaskKindName(stage.kind()), stage.done(), stage.total(), stage.running());
  }
  if (job.state() == v1::JOB_RUNNING) fmt::print("  {}\n", ProgressLine(job));
  for (const v1::ArtefactRef& output : job.outputs()) {
    fmt::print("  {:>10}  {}\n", FormatBytes(static_cast<double>(output.bytes())), output.name());
  }
  for (const std::string& line : WarningLines(job, kWarningLinesMax)) fmt::print("  warning: {}\n", line);
}

void ShowJob(const RemoteOptions& remote, const v1::JobStatus& job) {
  if (remote.json) {
    fmt::print("{}\n", DumpJson(JobJson(job)));
  } else if (!remote.quiet) {
    PrintJob(job);
  }
}

Result<v1::JobStatus> GetJob(Client* client, const std::string& job_id) {
  TREM_RETURN_IF_ERROR(CheckJobId(job_id));
  return client->GetJob(job_id);
}

Result<v1::JobStatus> Watch(Client* client, const RemoteOptions& remote, const std::string& job_id) {
  ProgressDisplay display(ProgressDisplay::ModeFor(remote.quiet));
  Absence absence;
  for (;;) {
    Result<v1::JobStatus> job = GetJob(client, job_id);
    if (!job.ok()) display.Clear();
    if (absence.Outlasts(job.status(), client)) continue;
    if (!job.ok()) return job;
    display.Show(*job);
    if (job->state() != v1::JOB_RUNNING) return job;
    TREM_RETURN_IF_ERROR(client->Pause(kPollInterval));
  }
}

// A question that is answered with a job's status, which is shown.
int AskAboutJob(const RemoteOptions& remote, const std::string& job_id, const v1::Envelope& question) {
  if (const Status status = CheckJobId(job_id); !status.ok()) return ReportFailure(status);
  Client client = MakeClient(remote);
  const Result<v1::Envelope> answer = client.Ask(question);
  if (!answer.ok()) return ReportFailure(answer.status());
  ShowJob(remote, answer->job_status());
  return kExitDone;
}

// A question that is answered with all workers, which are shown.
int AskForWorkers(const RemoteOptions& remote, const v1::Envelope& question) {
  Client client = MakeClient(remote);
  const Result<v1::Envelope> answer = client.Ask(question);
  if (!answer.ok()) return ReportFailure(answer.status());
  ordered_json json = ordered_json::array();
  for (const v1::WorkerStatus& worker : answer->worker_list().workers()) {
    json.push_back({{"worker_id", worker.worker_id()},
                    {"host", worker.host()},
                    {"pid", worker.pid()},
                    {"running", worker.running_size()},
                    {"draining", worker.draining()},
                    {"last_seen_ms_ago", worker.last_seen_ms_ago()}});
    if (!remote.json) {
      fmt::print("{:<40} {}:{}  {} running{}, seen {:.1f} s ago\n", worker.worker_id(), worker.host(), worker.pid(), worker.running_size(),
                 worker.draining() ? ", draining" : "", static_cast<double>(worker.last_seen_ms_ago()) / 1000.0);
    }
  }
  if (remote.json) fmt::print("{}\n", DumpJson(json));
  return kExitDone;
}

// An object store, read by the trem-worker beside this program: GDAL and its credentials are there.
class WorkerBacking final : public ArtefactBacking {
 public:
  WorkerBacking(std::string store, fs::path log) : store_(std::move(store)), log_(std::move(log)) {}

  Result<std::string> Fetch(const ArtefactRef& ref, const fs::path& path) override {
    TREM_ASSIGN_OR_RETURN(const fs::path folder, ProgramFolder());
    TREM_ASSIGN_OR_RETURN(const pid_t pid, StartChild({(folder / "trem-worker").string(), "get-artefact", "--store", store_, "--sha256",
                                                       ref.sha256, "--output", path.string()},
                                                      log_));
    std::optional<int> ended;
    while (!(ended = ReapChild(pid))) {
      if (InterruptSignal() != 0) return Cancelled("interrupted");  // The child ends with this process.
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    if (*ended == 0) return std::string();
    return Failed("result " + ref.name + ": " + LastLines(log_, 1));
  }
  Status Deliver(const ArtefactRef&, const fs::path&) override { return Failed("results are only read"); }

 private:
  std::string store_;
  fs::path log_;
};

Result<v1::Sortie> Upload(const RemoteOptions& remote, const v1::Sortie& sortie) {
  CountInterrupts();
  TREM_ASSIGN_OR_RETURN(const ChannelOptions options, ChannelOptionsOf(remote.key, remote.coordinator_key));
  const auto channel = std::make_shared<ArtefactChannel>(remote.coordinator, options);
  channel->set_on_chunk([] { return InterruptSignal() == 0; });
  return UploadSortie(sortie, channel);
}

// From the folder `store`, or in chunks from the coordinator. What has arrived when that breaks off is kept beside the output, and the
// same command goes on from there.
Result<std::vector<PublishedFile>> FetchOutputs(const RemoteOptions& remote, const v1::JobStatus& job, const fs::path& output,
                                                const fs::path& store_path) {
  if (!store_path.empty()) {
    std::error_code error;
    if (!fs::is_directory(store_path, error))
      return NotFound("artefact store '" + store_path.string() + "' is not a folder on this machine");
    TREM_ASSIGN_OR_RETURN(const ArtefactStore store, ArtefactStore::Open(store_path));
    return PublishOutputs(job, store, output, {});
  }
  const fs::path partial = output.string() + ".fetch";
  std::shared_ptr<ArtefactBacking> backing;
  if (job.store_path().starts_with("/vsi")) {
    backing = std::make_shared<WorkerBacking>(job.store_path(), partial / "tmp" / "get-artefact.log");
  } else {
    TREM_ASSIGN_OR_RETURN(const ChannelOptions options, ChannelOptionsOf(remote.key, remote.coordinator_key));
    const auto channel = std::make_shared<ArtefactChannel>(remote.coordinator, options);
    channel->set_on_chunk([] { return InterruptSignal() == 0; });
    backing = channel;
  }
  TREM_ASSIGN_OR_RETURN(const ArtefactStore store, ArtefactStore::OpenCache(partial, backing));
  auto files = PublishOutputs(job, store, output, {});
  std::error_code ignored;
  if (files.ok()) fs::remove_all(partial, ignored);
  return files;
}

}  // namespace

int RunSubmitCommand(const RemoteOptions& remote, const std::string& sortie, const std::vector<std::string>& overrides,
                     const std::string& job_id, bool upload, int priority) {
  Result<v1::Sortie> spec = LoadSortie(sortie, overrides);
  if (spec.ok() && upload) spec = Upload(remote, *spec);
  if (!spec.ok()) return ReportFailure(spec.status());
  const std::string id = job_id.empty() ? NewJobId(spec->name()) : job_id;
  if (const Status status = CheckJobId(id); !status.ok()) return ReportFailure(status);
  Client client = MakeClient(remote);
  const Result<v1::JobStatus> job = client.Submit(id, *spec, priority);
  if (!job.ok()) return ReportFailure(job.status());
  if (remote.json) {
    fmt::print("{}\n", DumpJson(JobJson(*job)));
  } else {
    fmt::print("{}\n", id);
  }
  return kExitDone;
}

int RunListCommand(const RemoteOptions& remote) {
  Client client = MakeClient(remote);
  v1::Envelope question;
  question.mutable_list_jobs();
  const Result<v1::Envelope> answer = client.Ask(question);
  if (!answer.ok()) return ReportFailure(answer.status());
  if (remote.json) {
    ordered_json json = ordered_json::array();
    for (const v1::JobStatus& job : answer->job_list().jobs()) json.push_back(JobJson(job));
    fmt::print("{}\n", DumpJson(json));
    return kExitDone;
  }
  for (const v1::JobStatus& job : answer->job_list().jobs()) {
    fmt::print("{:<40} {:<10} {:3.0f}%  {}\n", job.job_id(), JobStateName(job.state()), job.fraction() * 100.0, job.name());
  }
  return kExitDone;
}

int RunStatusCommand(const RemoteOptions& remote, const std::string& job_id) {
  Client client = MakeClient(remote);
  const Result<v1::JobStatus> job = GetJob(&client, job_id);
  if (!job.ok()) return ReportFailure(job.status());
  ShowJob(remote, *job);
  return kExitDone;
}

int RunWatchCommand(const RemoteOptions& remote, const std::string& job_id) {
  Client client = MakeClient(remote);
  const Result<v1::JobStatus> job = Watch(&client, remote, job_id);
  if (!job.ok()) return ReportFailure(job.status());
  ShowJob(remote, *job);
  if (job->state() == v1::JOB_DONE) return kExitDone;
  if (job->state() == v1::JOB_DONE_IN_PART) return kExitDoneInPart;
  PrintError("job " + job_id + " " + (job->error().empty() ? "is " + JobStateName(job->state()) : "failed: " + job->error()));
  return kExitFailed;
}

int RunCancelCommand(const RemoteOptions& remote, const std::string& job_id) {
  v1::Envelope question;
  question.mutable_cancel_job()->set_job_id(job_id);
  return AskAboutJob(remote, job_id, question);
}

int RunRetryCommand(const RemoteOptions& remote, const std::string& job_id) {
  v1::Envelope question;
  question.mutable_retry_job()->set_job_id(job_id);
  return AskAboutJob(remote, job_id, question);
}

int RunRemoveCommand(const RemoteOptions& remote, const std::string& job_id) {
  if (const Status status = CheckJobId(job_id); !status.ok()) return ReportFailure(status);
  v1::Envelope question;
  question.mutable_remove_job()->set_job_id(job_id);
  const Result<v1::Envelope> answer = MakeClient(remote).Ask(question);
  if (!answer.ok()) return ReportFailure(answer.status());
  if (!remote.quiet && !remote.json) fmt::print("job {} is forgotten; what only it had leaves the artefact store within minutes\n", job_id);
  return kExitDone;
}

int RunDrainCommand(const RemoteOptions& remote, const std::string& worker_id) {
  if (!IsWorkerId(worker_id)) return ReportFailure(InvalidInput("'" + worker_id + "' is not a worker's id; 'trem workers' shows them"));
  v1::Envelope question;
  question.mutable_drain_worker()->set_worker_id(worker_id);
  return AskForWorkers(remote, question);
}

int RunFetchCommand(const RemoteOptions& remote, const std::string& job_id, const fs::path& output, const fs::path& store) {
  if (const Status status = CheckOutput(output); !status.ok()) return ReportFailure(status);
  Client client = MakeClient(remote);
  const Result<v1::JobStatus> job = GetJob(&client, job_id);
  if (!job.ok()) return ReportFailure(job.status());
  if (job->state() != v1::JOB_DONE && job->state() != v1::JOB_DONE_IN_PART) {
    return ReportFailure(
        Failed("job " + job_id + " is " + JobStateName(job->state()) + "; only the results of a job that is done can be fetched"));
  }
  const Result<std::vector<PublishedFile>> files = FetchOutputs(remote, *job, output, store);
  if (!files.ok()) return ReportFailure(files.status());
  ordered_json json = ordered_json::array();
  for (const PublishedFile& file : *files) {
    if (!remote.json && !remote.quiet) fmt::print("{:>10}  {}\n", FormatBytes(static_cast<double>(file.bytes)), file.path.string());
    json.push_back({{"name", file.name}, {"path", file.path.string()}, {"bytes", file.bytes}, {"sha256", file.sha256}});
  }
  if (remote.json) fmt::print("{}\n", DumpJson(json));
  return kExitDone;
}

int RunWorkersCommand(const RemoteOptions& remote) {
  v1::Envelope question;
  question.mutable_list_workers();
  return AskForWorkers(remote, question);
}

}  // namespace trem
