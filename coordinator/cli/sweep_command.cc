#include "coordinator/cli/sweep_command.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/probe_folder.h"
#include "coordinator/cli/remote.h"
#include "coordinator/cli/terminal.h"
#include "mosaic/base/file.h"
#include "mosaic/base/sweep.h"

namespace trem {
namespace {

// Packed digests of all artefacts that some job has.
Result<std::string> AskInUse(Client* client) {
  std::string packed;
  v1::Envelope question;
  question.mutable_list_artefacts();
  for (bool is_last = false; !is_last;) {
    TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, client->Ask(question));
    if (!answer.has_artefact_list()) return Corrupt("the coordinator answered with something else than a list of artefacts");
    const std::string& page = answer.artefact_list().digests();
    is_last = answer.artefact_list().is_last() || page.empty();
    packed += page;
    TREM_ASSIGN_OR_RETURN(const std::vector<std::string> digests, UnpackDigests(page));
    if (!digests.empty()) question.mutable_list_artefacts()->set_after(digests.back());
  }
  return packed;
}

Result<SweepReport> Sweep(const RemoteOptions& remote, std::int64_t older_than_s) {
  Client client = MakeClient(remote);
  v1::Envelope question;
  question.mutable_get_service_report();
  TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, client.Ask(question));
  const v1::ServiceReport& service = answer.service_report();
  if (!service.store_path().starts_with("/vsi")) {
    return InvalidInput("the store " + service.store_path() +
                        " is a folder, which its coordinator sweeps by itself; this is for object stores");
  }
  TREM_ASSIGN_OR_RETURN(const std::string in_use, AskInUse(&client));
  const ProbeFolder folder;
  TREM_RETURN_IF_ERROR(WriteFileAtomically(folder / "in-use", in_use));
  TREM_ASSIGN_OR_RETURN(const std::filesystem::path programs, ProgramFolder());
  TREM_ASSIGN_OR_RETURN(const std::string output, OutputOf({(programs / "trem-worker").string(), "sweep-store", "--store",
                                                            service.store_path(), "--in-use", (folder / "in-use").string(), "--owner",
                                                            service.state_id(), "--older-than-s", std::to_string(older_than_s)}));
  SweepReport report;
  std::istringstream numbers(output);
  if (numbers >> report.removed_objects >> report.removed_bytes >> report.bytes) return report;
  return Corrupt("trem-worker sweep-store says '" + output + "'; is it of another release?");
}

}  // namespace

int RunSweepCommand(const RemoteOptions& remote, std::int64_t older_than_s) {
  const Result<SweepReport> report = Sweep(remote, older_than_s);
  if (!report.ok()) return ReportFailure(report.status());
  if (remote.json) {
    const nlohmann::ordered_json json = {
        {"removed_objects", report->removed_objects}, {"removed_bytes", report->removed_bytes}, {"bytes", report->bytes}};
    fmt::print("{}\n", DumpJson(json));
  } else if (!remote.quiet) {
    fmt::print("{} objects of {} removed; {} are left\n", report->removed_objects, FormatBytes(static_cast<double>(report->removed_bytes)),
               FormatBytes(static_cast<double>(report->bytes)));
  }
  return kExitDone;
}

}  // namespace trem
