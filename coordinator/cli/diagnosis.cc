#include "coordinator/cli/diagnosis.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "coordinator/cli/remote.h"
#include "coordinator/cli/terminal.h"
#include "mosaic/base/version.h"

namespace trem {
namespace {

// S3 refuses signatures that are a quarter of an hour off; a minute already misleads who compares logs.
constexpr std::int64_t kClockSkewMsMax = 60'000;
constexpr std::uint64_t kSilenceMsMax = 10'000;
constexpr std::uint64_t kStateBytesWanted = 1'000'000'000;
constexpr std::uint64_t kStoreBytesWanted = 5'000'000'000;
constexpr double kNearlyFull = 0.9;

std::string Seconds(std::int64_t ms) { return fmt::format("{:.0f} s", std::abs(static_cast<double>(ms)) / 1000.0); }

std::string AheadOrBehind(std::int64_t ms) { return Seconds(ms) + (ms >= 0 ? " ahead of" : " behind"); }

constexpr const char* kSetClocks =
    "have both machines' clocks set by NTP (chrony, systemd-timesyncd): object stores refuse requests of a clock that is 15 minutes off, "
    "and "
    "times in logs do not fit together";

Finding JudgeClock(const v1::ServiceReport& report, std::uint64_t clock_ms) {
  if (report.clock_ms() == 0) return {"clock", true, "the coordinator does not say", ""};
  const std::int64_t ahead_ms = static_cast<std::int64_t>(report.clock_ms()) - static_cast<std::int64_t>(clock_ms);
  if (std::abs(ahead_ms) <= kClockSkewMsMax) return {"clock", true, "the coordinator's agrees with this machine's", ""};
  return {"clock", false, "the coordinator's is " + AheadOrBehind(ahead_ms) + " this machine's", kSetClocks};
}

Finding JudgeStoreQuota(const v1::ServiceReport& report) {
  const auto bytes = static_cast<double>(report.store_bytes());
  const auto bytes_max = static_cast<double>(report.store_bytes_max());
  const std::string advice = "remove jobs that are not needed any more (trem remove), or raise --store-bytes-max of the coordinator";
  if (!report.refuses_jobs().empty()) return {"store quota", false, "new jobs and uploads are refused: " + report.refuses_jobs(), advice};
  if (report.store_bytes_max() == 0) return {"store quota", true, "none", ""};
  return {"store quota", bytes < kNearlyFull * bytes_max, fmt::format("{} of {} used", FormatBytes(bytes), FormatBytes(bytes_max)), advice};
}

Finding JudgeUserQuota(const v1::ServiceReport& report) {
  std::string text = fmt::format("{} job{} of yours running", report.user_jobs(), report.user_jobs() == 1 ? "" : "s");
  if (report.user_jobs_max() > 0) text += fmt::format(", at most {} allowed", report.user_jobs_max());
  if (report.user_tasks_max() > 0) text += fmt::format("; at most {} of your tasks run at once", report.user_tasks_max());
  return {"user quota", report.user_jobs_max() == 0 || report.user_jobs() < report.user_jobs_max(), text,
          "a further job is refused until one ends or is cancelled (trem cancel); the coordinator's --user-jobs-max sets the limit"};
}

std::uint64_t LargestMemory(const v1::WorkerList& workers) {
  std::uint64_t most = 0;
  for (const v1::WorkerStatus& worker : workers.workers()) most = std::max<std::uint64_t>(most, worker.memory_bytes_max());
  return most;
}

}  // namespace

Finding JudgeDisk(const std::string& subject, const std::string& folder, std::uint64_t bytes_free, std::uint64_t bytes_wanted) {
  return {subject, bytes_free >= bytes_wanted, fmt::format("{} free in {}", FormatBytes(static_cast<double>(bytes_free)), folder),
          fmt::format("make room there: less than {} is too little to go on for long; what waits goes on by itself when there is room",
                      FormatBytes(static_cast<double>(bytes_wanted)))};
}

Finding JudgeReach(Reach reach, const std::string& endpoint, const std::string& key, const std::string& coordinator_key) {
  const char* const subject = "connection";
  switch (reach) {
    case Reach::kReady:
      return {subject, true, endpoint + (key.empty() ? ", no keys in use" : ", encrypted, key '" + key + "' is let in"), ""};
    case Reach::kNobodyListens:
      return {
          subject, false, "nothing listens at " + endpoint,
          "start trem-coordinator there (systemctl status trem-coordinator, kubectl get pods, squeue tell why it does not run), or name "
          "another endpoint with --coordinator or TREM_COORDINATOR"};
    case Reach::kNoWay:
      return {subject, false, "nothing comes back from " + endpoint,
              "check the host's name, that the machine is up, and the firewalls between: TCP to this port has to pass"};
    case Reach::kKeyNotAllowed:
      return {subject, false, "the coordinator at " + endpoint + " does not let the key '" + key + "' in",
              "copy " + key + ".pub into the folder that the coordinator's --allow names; that takes effect at once"};
    case Reach::kOtherKey:
      if (key.empty())
        return {
            subject, false, "whoever answers at " + endpoint + " is no coordinator, or takes no more connections",
            "check the port; a coordinator that wants keys may hang up like this: name yours with --key and --coordinator-key; one that is "
            "full counts it (trem_connections_refused_total{lane=\"control\",reason=\"full\"}, --connections-max)"};
      return {subject, false, "whoever answers at " + endpoint + " does not have the key of " + coordinator_key,
              "get the coordinator's present .pub file from whoever runs it; if its key was not changed, find out who answers there, "
              "whether it uses keys at all, or whether it is full (--connections-max)"};
    case Reach::kKeysDiffer:
      if (key.empty()) {
        return {subject, false, "the coordinator at " + endpoint + " wants keys",
                "name your .key file with --key (TREM_KEY) and the coordinator's .pub file with --coordinator-key (TREM_COORDINATOR_KEY)"};
      }
      return {subject, false, "the coordinator at " + endpoint + " uses no keys",
              "leave --key and --coordinator-key (TREM_KEY, TREM_COORDINATOR_KEY) out, or start it with --key and --allow"};
  }
  return {subject, false, "unknown", ""};
}

Finding JudgeRefusal(const Status& status) {
  Finding finding{"coordinator", false, status.message(), ""};
  switch (status.code()) {
    case StatusCode::kUnavailable:
      finding.advice = "the connection stands, but no answer comes: look at the coordinator's log, and whether it hangs (/healthz)";
      break;
    case StatusCode::kExhausted:
      finding.advice = "make room on that disk (trem remove, old backups); it goes on by itself";
      break;
    default:
      break;  // The message says what to do.
  }
  return finding;
}

std::vector<Finding> JudgeReport(const v1::ServiceReport& report, std::uint64_t clock_ms) {
  std::vector<Finding> findings;
  const bool is_same = report.version() == TREM_VERSION && report.engine_revision() == kEngineRevision;
  findings.push_back(
      {"release", true,
       fmt::format(
           "coordinator {} (engine revision {}){}", ForTerminal(report.version()), ForTerminal(report.engine_revision()),
           is_same ? ", as here" : fmt::format("; here {} ({}): clients may differ, workers must not", TREM_VERSION, kEngineRevision)),
       ""});
  findings.push_back(JudgeClock(report, clock_ms));
  findings.push_back(JudgeDisk("state disk", ForTerminal(report.state_path()), report.state_bytes_free(), kStateBytesWanted));
  if (!report.store_path().starts_with("/vsi")) {
    findings.push_back(JudgeDisk("store disk", ForTerminal(report.store_path()), report.store_bytes_free(), kStoreBytesWanted));
  }
  findings.push_back(JudgeStoreQuota(report));
  findings.push_back(JudgeUserQuota(report));
  for (const v1::RefusedWorker& refused : report.refused_workers()) {
    findings.push_back({"refused worker", false,
                        fmt::format("{} ago, on {}: {}", Seconds(static_cast<std::int64_t>(refused.ms_ago())), ForTerminal(refused.host()),
                                    ForTerminal(refused.reason())),
                        "install the coordinator's release there and start the worker again (trem-worker --version tells both)"});
  }
  return findings;
}

std::vector<Finding> JudgeWorkers(const v1::WorkerList& workers, bool job_waits) {
  int draining = 0;
  std::vector<Finding> findings;
  for (const v1::WorkerStatus& worker : workers.workers()) {
    draining += worker.draining() ? 1 : 0;
    const std::string name = worker.worker_id() + " on " + ForTerminal(worker.host());
    if (std::abs(worker.clock_ahead_ms()) > kClockSkewMsMax) {
      findings.push_back(
          {"clock", false, "worker " + name + " is " + AheadOrBehind(worker.clock_ahead_ms()) + " the coordinator", kSetClocks});
    }
    if (worker.last_seen_ms_ago() > kSilenceMsMax) {
      findings.push_back({"worker", false,
                          "nothing was heard of " + name + " for " + Seconds(static_cast<std::int64_t>(worker.last_seen_ms_ago())),
                          "it is stopped, or its network is: its tasks go to others soon; look at its log"});
    }
  }
  const int count = workers.workers_size();
  Finding fleet{"workers", true, fmt::format("{} connected", count), ""};
  if (count == 0) {
    fleet.is_good = false;
    fleet.text = job_waits ? "none is connected, and jobs wait" : "none is connected";
    fleet.advice =
        "start some: trem-worker serve --coordinator ENDPOINT (sbatch workers.sbatch, kubectl scale, systemctl start trem-worker@1); one "
        "that was "
        "refused says why on its stderr";
  } else if (draining == count) {
    fleet.is_good = false;
    fleet.text = count == 1 ? "the only one is draining and takes no task" : fmt::format("all {} are draining and take no task", count);
    fleet.advice = "start new ones; a drained worker leaves when it is done and does not come back by itself";
  } else if (draining > 0) {
    fleet.text += fmt::format(", {} of them draining", draining);
  }
  findings.insert(findings.begin(), fleet);
  return findings;
}

std::vector<Finding> JudgeJob(const v1::JobStatus& job, const v1::WorkerList& workers) {
  std::vector<Finding> findings;
  for (const v1::Note& note : job.notes()) {
    if (note.code() != "waiting_for_memory") continue;
    findings.push_back(
        {"memory limits", false,
         fmt::format("job {}: {}; the largest limit of a worker is {}", job.job_id(), ForTerminal(note.message()),
                     FormatBytes(static_cast<double>(LargestMemory(workers)))),
         "start a worker with a larger --memory-max-bytes (Slurm: --mem, Kubernetes: resources.limits.memory), or submit the job "
         "with smaller windows (--set windows.roi_px=121, --set windows.frames=48)"});
  }
  return findings;
}

Finding JudgeScaler(const std::string& note, std::uint64_t clock_ms) {
  constexpr std::uint64_t kStepsMissedMax = 3;
  constexpr std::uint64_t kGraceS = 30;
  const char* const subject = "Slurm scaler";
  if (note.empty()) {
    return {subject, false, "it has never run for this service folder",
            "start deploy/slurm/scaler.sh MIN MAX where sbatch works, or start workers by hand (sbatch --array=1-N workers.sbatch)"};
  }
  std::istringstream text(note);
  std::uint64_t time_s = 0;
  std::uint64_t interval_s = 0;
  std::string words;
  text >> time_s >> interval_s;
  std::getline(text >> std::ws, words);
  words = ForTerminal(words);
  const std::uint64_t now_s = clock_ms / 1000;
  const std::uint64_t age_s = now_s > time_s ? now_s - time_s : 0;
  if (age_s > kStepsMissedMax * interval_s + kGraceS) {
    return {subject, false, fmt::format("its last step was {} s ago, one is due every {} s: {}", age_s, interval_s, words),
            "it has ended, or its node has: start deploy/slurm/scaler.sh again"};
  }
  const bool is_good = words.starts_with("ok");
  return {subject, is_good, words,
          "run the command that it names by hand, as the user that the scaler runs as: Slurm's own message tells the rest"};
}

}  // namespace trem
