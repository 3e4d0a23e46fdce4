#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/channel/connection_probe.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// One thing that `trem doctor` has looked at.
struct Finding {
  std::string subject;
  bool is_good = true;
  std::string text;
  std::string advice;  // What to do when it is not good.
};

// What to make of what was seen. Pure: the looking is doctor_command.cc's and doctor_service.cc's.

// Free space in bytes below which `folder` counts as nearly full.
Finding JudgeDisk(const std::string& subject, const std::string& folder, std::uint64_t bytes_free, std::uint64_t bytes_wanted);
// Of an attempt to connect. `key`: the name of the own one; empty: none. `coordinator_key`: the file that names the coordinator's.
Finding JudgeReach(Reach reach, const std::string& endpoint, const std::string& key, const std::string& coordinator_key);
// Of an answer that is an error: another protocol, a full disk, a role.
Finding JudgeRefusal(const Status& status);
// `clock_ms`: of this machine.
std::vector<Finding> JudgeReport(const v1::ServiceReport& report, std::uint64_t clock_ms);
// `job_waits`: a job runs, so that workers are missed.
std::vector<Finding> JudgeWorkers(const v1::WorkerList& workers, bool job_waits);
// Of a running job: what keeps it.
std::vector<Finding> JudgeJob(const v1::JobStatus& job, const v1::WorkerList& workers);
// Of what deploy/slurm/scaler.sh has left in the service folder: its time, interval and words. `note`: the file's text; empty: none.
Finding JudgeScaler(const std::string& note, std::uint64_t clock_ms);

}  // namespace trem
