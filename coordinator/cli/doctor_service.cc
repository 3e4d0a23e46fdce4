// The part of `trem doctor` that asks a coordinator and looks at its store.
#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <system_error>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/client.h"
#include "coordinator/cli/doctor_command.h"
#include "coordinator/cli/probe_folder.h"
#include "coordinator/cli/remote.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "mosaic/base/wall_clock.h"
#include "proto/channel/artefact_channel.h"
#include "proto/channel/connection_probe.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPatience{5000};
constexpr int kJobsLookedAtMax = 20;

// A few bytes there and back, the way that uploads and results go. What was put leaves the store with a later sweep.
Finding CheckDataLane(const std::string& endpoint, const std::string& coordinator, const ChannelOptions& options) {
  const std::string subject = "data lane";
  const std::string text = "trem doctor was here\n";
  const ProbeFolder folder;
  const ArtefactRef ref{"doctor", Sha256Hex(text), text.size()};
  Status status = WriteFileAtomically(folder / "there", text);
  ArtefactChannel lane(coordinator, options);
  if (status.ok()) status = lane.Deliver(ref, folder / "there");
  if (!status.ok()) {
    return {subject, false, "an upload to " + endpoint + " fails: " + status.message(),
            status.code() == StatusCode::kExhausted ? "make room in the store: trem remove, or a larger --store-bytes-max"
                                                    : "the port of --data-bind has to be reachable from here too (by default it is any "
                                                      "free one: name one and let the firewall pass it)"};
  }
  const Result<std::string> back = lane.Fetch(ref, folder / "back");
  status = back.ok() && *back != ref.sha256 ? Corrupt("other bytes came back than went there") : back.status();
  if (!status.ok()) return {subject, false, "a download from " + endpoint + " fails: " + status.message(), "look at the coordinator's log"};
  return {subject, true, endpoint + ", a file went there and back", ""};
}

Finding CheckObjectStore(const std::string& store) {
  const std::string subject = "object store";
  const auto folder = ProgramFolder();
  if (!folder.ok()) return {subject, false, folder.status().message(), ""};
  const auto output = OutputOf({(*folder / "trem-worker").string(), "check-store", "--store", store});
  if (output.ok()) return {subject, true, store + ", an object went there and back from this machine", ""};
  return {subject, false, output.status().message(),
          "set address and credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY or AWS_PROFILE; AWS_S3_ENDPOINT, "
          "AWS_VIRTUAL_HOSTING and AWS_HTTPS for a server of your own) of every worker and of who fetches; look at the clock too"};
}

Finding CheckSharedStore(const std::string& store) {
  const std::string subject = "artefact store";
  const fs::path objects = fs::path(store) / "objects";
  std::error_code error;
  if (!fs::is_directory(objects, error)) {
    return {subject, false, store + " is no artefact store, seen from here",
            "is it mounted? A machine that does not share it leaves --store out and uses the data lane"};
  }
  const fs::path probe = fs::path(store) / "tmp" / fmt::format("doctor-{}", ::getpid());
  const Status written = WriteFileAtomically(probe, "x");
  fs::remove(probe, error);
  return {subject, written.ok(), written.ok() ? store + " can be written to" : written.message(),
          "workers that are given this --store have to write to it: look at owner, mode and mount options"};
}

std::vector<Finding> CheckJobs(Client* client, const v1::WorkerList& workers, bool* job_waits) {
  std::vector<Finding> findings;
  v1::Envelope question;
  question.mutable_list_jobs();
  const Result<v1::Envelope> jobs = client->Ask(question);
  if (!jobs.ok()) return {JudgeRefusal(jobs.status())};
  int looked_at = 0;
  for (const v1::JobStatus& job : jobs->job_list().jobs()) {
    if (job.state() != v1::JOB_RUNNING || ++looked_at > kJobsLookedAtMax) continue;
    *job_waits = true;
    // The list leaves the notes out.
    if (const auto status = client->GetJob(job.job_id()); status.ok()) {
      for (Finding& finding : JudgeJob(*status, workers)) findings.push_back(std::move(finding));
    }
  }
  return findings;
}

std::vector<Finding> AskCoordinator(const RemoteOptions& remote, const ChannelOptions& options, std::string* store) {
  std::vector<Finding> findings;
  Client client(remote.coordinator, kPatience, {}, {remote.key, remote.coordinator_key});
  v1::Envelope question;
  question.mutable_get_service_report();
  const Result<v1::Envelope> report = client.Ask(question);
  if (!report.ok()) return {JudgeRefusal(report.status())};
  findings.push_back({"coordinator", true, remote.coordinator + " answers", ""});
  for (Finding& finding : JudgeReport(report->service_report(), WallClockMs())) findings.push_back(std::move(finding));
  if (store->empty() && report->service_report().store_path().starts_with("/vsi")) *store = report->service_report().store_path();

  question.mutable_list_workers();
  const Result<v1::Envelope> workers = client.Ask(question);
  if (!workers.ok()) return findings.push_back(JudgeRefusal(workers.status())), findings;
  bool job_waits = false;
  std::vector<Finding> of_jobs = CheckJobs(&client, workers->worker_list(), &job_waits);
  for (Finding& finding : JudgeWorkers(workers->worker_list(), job_waits)) findings.push_back(std::move(finding));
  for (Finding& finding : of_jobs) findings.push_back(std::move(finding));

  question.mutable_get_data_lane();
  const Result<v1::Envelope> lane = client.Ask(question);
  if (lane.ok()) {
    findings.push_back(CheckDataLane(lane->data_lane().endpoint(), remote.coordinator, options));
  } else {
    // Those who share the store need no lane.
    findings.push_back(
        {"data lane", lane.status().code() == StatusCode::kInvalidInput, lane.status().message(), "look at the coordinator's log"});
  }
  return findings;
}

Finding CheckScaler(const std::string& service) {
  const auto note = ReadFile(fs::path(service) / "scaler", 4096);
  return JudgeScaler(note.ok() ? *note : "", WallClockMs());
}

}  // namespace

std::vector<Finding> CheckService(const RemoteOptions& remote, const DoctorOptions& options) {
  std::vector<Finding> findings;
  std::string store = options.store;
  const Result<ChannelOptions> channel = ChannelOptionsOf(remote.key, remote.coordinator_key);
  if (!channel.ok()) {
    findings.push_back({"keys", false, channel.status().message(),
                        "a .key file has to be its user's own with mode 0600 (chmod 600, chown); `trem keys` makes a new pair"});
  } else {
    const std::string key = channel->own_key ? channel->own_key->name() : "";
    findings.push_back({"keys", true, key.empty() ? "none" : key + ", " + RoleName(channel->own_key->role()), ""});
    if (!remote.coordinator.empty()) {
      const Result<Reach> reach = ProbeConnection(remote.coordinator, *channel, kPatience);
      findings.push_back(reach.ok() ? JudgeReach(*reach, remote.coordinator, key, remote.coordinator_key)
                                    : Finding{"connection", false, reach.status().message(), "correct --coordinator (TREM_COORDINATOR)"});
      if (reach.ok() && *reach == Reach::kReady) {
        for (Finding& finding : AskCoordinator(remote, *channel, &store)) findings.push_back(std::move(finding));
      }
    }
  }
  if (!store.empty()) findings.push_back(store.starts_with("/vsi") ? CheckObjectStore(store) : CheckSharedStore(store));
  if (!options.service.empty()) findings.push_back(CheckScaler(options.service));
  return findings;
}

}  // namespace trem
