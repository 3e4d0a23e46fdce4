#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// Lower-case names, as in the JSON outputs: "enhance", "done", "warning".
std::string TaskKindName(v1::TaskKind kind);
std::string JobStateName(v1::JobState state);

// A job for programs: job_id, name, state, fraction, eta_s, eta_low_s and eta_high_s (null: unknown), stages, outputs, notes,
// peak_memory_bytes, worker_count, retries, and error {code, message} when it failed.
nlohmann::ordered_json JobJson(const v1::JobStatus& job);

// The job's warnings for people, one a line, at most `count_max`, then how many more there are.
std::vector<std::string> WarningLines(const v1::JobStatus& job, std::size_t count_max);

// JSON text that is valid whatever bytes the strings hold (invalid UTF-8 is replaced).
std::string DumpJson(const nlohmann::ordered_json& json);

}  // namespace trem
