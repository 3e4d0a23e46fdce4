#pragma once

#include <string>
#include <vector>

#include "coordinator/cli/client_commands.h"
#include "coordinator/cli/diagnosis.h"

namespace trem {

struct DoctorOptions {
  std::string store;    // Artefact store to look at from here; empty: the one that the coordinator names, when it is an object store.
  std::string service;  // Service folder of a Slurm installation (deploy/slurm/setup.sh); empty: none.
};

// `trem doctor`: programs, processor, memory, disk, limits, keys and, where they are named, the coordinator with its workers, jobs, quotas
// and data lane, the artefact store, and the Slurm scaler. Says of everything that is wrong what to do. Exit code 0 when nothing is.
int RunDoctorCommand(const RemoteOptions& remote, const DoctorOptions& options);

// The part that asks a coordinator and looks at its store (doctor_service.cc).
std::vector<Finding> CheckService(const RemoteOptions& remote, const DoctorOptions& options);

}  // namespace trem
