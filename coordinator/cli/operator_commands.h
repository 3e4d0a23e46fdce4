#pragma once

#include <cstdint>
#include <string>

#include "coordinator/cli/client_commands.h"

namespace trem {

struct LogsOptions {
  std::string job_id;
  // Empty or 0: any.
  std::string task;  // Title, or how its key begins.
  std::uint32_t attempt = 0;
  std::string worker_id;
  bool newest = false;  // One page, the newest.
  bool follow = false;  // Until the job ends.
};

struct TopOptions {
  double interval_s = 2.0;
  bool once = false;
};

// Each returns the exit code of `trem`.
int RunLogsCommand(const RemoteOptions& remote, const LogsOptions& options);
int RunTopCommand(const RemoteOptions& remote, const TopOptions& options);
// `name`: of the copy; empty: made of date and time.
int RunBackupCommand(const RemoteOptions& remote, std::string name);

}  // namespace trem
