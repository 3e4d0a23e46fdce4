#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace trem {

// Options that every command for a running coordinator shares.
struct RemoteOptions {
  std::string coordinator;      // Endpoint.
  std::string key;              // Own .key file; empty: no keys.
  std::string coordinator_key;  // The coordinator's .pub file.
  bool json = false;
  bool quiet = false;
};

// Each returns the exit code of `trem`. `upload`: bring the sortie's files to the coordinator's store first, for workers that cannot read
// them where they are. `priority`: -10..10.
int RunSubmitCommand(const RemoteOptions& remote, const std::string& sortie, const std::vector<std::string>& overrides,
                     const std::string& job_id, bool upload, int priority);
int RunListCommand(const RemoteOptions& remote);
int RunStatusCommand(const RemoteOptions& remote, const std::string& job_id);
int RunWatchCommand(const RemoteOptions& remote, const std::string& job_id);
int RunCancelCommand(const RemoteOptions& remote, const std::string& job_id);
// Takes up what failed of a job; what is done stays done.
int RunRetryCommand(const RemoteOptions& remote, const std::string& job_id);
int RunRemoveCommand(const RemoteOptions& remote, const std::string& job_id);
// The worker gets nothing new and leaves when it has finished what it runs.
int RunDrainCommand(const RemoteOptions& remote, const std::string& worker_id);
// `store`: the artefact store as this machine sees it; empty: the results come in chunks from the coordinator.
int RunFetchCommand(const RemoteOptions& remote, const std::string& job_id, const std::filesystem::path& output,
                    const std::filesystem::path& store);
int RunWorkersCommand(const RemoteOptions& remote);

}  // namespace trem
