#include "coordinator/app/restore_command.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <iostream>
#include <string>

#include "coordinator/scheduling/scheduler.h"
#include "coordinator/store/event_store.h"
#include "mosaic/base/exit_code.h"

namespace trem {
namespace {

// Reads the log as a coordinator does at its start, so that what it would stumble over is known now.
Result<std::size_t> CountEvents(const std::string& state_folder) {
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<EventStore> events, EventStore::Open(state_folder));
  Scheduler scheduler;
  std::size_t count = 0;
  TREM_RETURN_IF_ERROR(events->Replay([&](std::int64_t, const v1::LogEvent& event) {
    ++count;
    return scheduler.Restore(event);
  }));
  return count;
}

}  // namespace

int RunRestoreCommand(int argc, char** argv) {
  std::string backup;
  std::string state_folder;
  CLI::App app("Puts a backup (`trem backup`) in the place of the log in --state. The coordinator must be stopped.",
               "trem-coordinator restore");
  app.add_option("BACKUP", backup, "The file that `trem backup` made")->required();
  app.add_option("--state", state_folder, "Folder of the event log; what it holds is kept in a folder in it")->required();
  app.footer(
      "What was computed since the backup is computed again where it is needed; jobs submitted since are not known any more.\n\n"
      "Examples:\n  trem-coordinator restore /var/backups/trem/nightly.sqlite --state /var/lib/trem/state");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kExitDone : kExitUsage;
  }
  const Result<std::filesystem::path> kept = EventStore::Restore(backup, state_folder);
  const Result<std::size_t> count = kept.ok() ? CountEvents(state_folder) : Result<std::size_t>(kept.status());
  if (!count.ok()) {
    std::cerr << "trem-coordinator: " << count.status().message() << '\n';
    return ExitCodeOf(count.status());
  }
  fmt::print("{} events restored into {}\n", *count, state_folder);
  if (!kept->empty()) fmt::print("what was there before is in {}\n", kept->string());
  return kExitDone;
}

}  // namespace trem
