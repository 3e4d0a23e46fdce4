#include "coordinator/cli/app.h"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/client_commands.h"
#include "coordinator/cli/doctor_command.h"
#include "coordinator/cli/keys_command.h"
#include "coordinator/cli/operator_commands.h"
#include "coordinator/cli/plan_command.h"
#include "coordinator/cli/run_command.h"
#include "coordinator/cli/sweep_command.h"
#include "coordinator/cli/terminal.h"
#include "mosaic/base/suggest.h"
#include "mosaic/base/version.h"

namespace trem {
namespace {

constexpr int kWorkersMax = 256;

struct WorkerCommand {
  const char* name;
  const char* description;
};
// Commands that touch pixels run in trem-worker, with the same arguments.
constexpr WorkerCommand kWorkerCommands[] = {
    {"inspect", "What a sortie holds: frames, sizes, telemetry, gaps, suspicious values"},
    {"enhance", "Resolution enhancement alone, on one region of the sensor"},
    {"simulate", "Render a sortie with known truth from an image"},
};

// What the parsed command line asks for.
struct Request {
  RunOptions run;
  RemoteOptions remote;
  std::string sortie;
  std::vector<std::string> overrides;
  std::vector<std::string> mosaic;  // Overrides that mosaic options stand for.
  std::string job_id;
  int priority = 0;
  LogsOptions logs;
  TopOptions top;
  DoctorOptions doctor;
  std::int64_t older_than_s = 86'400;
  std::string output;
  std::string role;
  std::string store;
  std::string work_folder;
  bool json = false;
  bool upload = false;
  std::function<int()> action;
};

int ExecWorker(int argc, char** argv) {
  const auto folder = ProgramFolder();
  if (!folder.ok()) {
    PrintError(folder.status().message());
    return kExitFailed;
  }
  std::string program = (*folder / "trem-worker").string();
  std::vector<char*> arguments = {program.data()};
  arguments.insert(arguments.end(), argv + 1, argv + argc);
  arguments.push_back(nullptr);
  std::fflush(nullptr);
  ::execv(program.c_str(), arguments.data());
  PrintError("cannot start " + program + ": " + std::strerror(errno) + "; is the installation complete?");
  return kExitFailed;
}

// Options that are fields of Sortie.mosaic, and further recordings; they come before --set, which has the last word.
void AddMosaicOptions(CLI::App* command, Request* request) {
  command
      ->add_option_function<std::vector<std::string>>(
          "--also",
          [request](const std::vector<std::string>& sorties) {
            for (const std::string& sortie : sorties) request->mosaic.push_back("more=" + sortie);
          },
          "One more recording by the same sensor, aligned with SORTIE into one mosaic; may be repeated")
      ->type_name("SORTIE")
      ->allow_extra_args(false);
  const auto field = [&](const std::string& option, const std::string& name, const std::string& type, const std::string& text) {
    command
        ->add_option_function<std::string>(
            option, [request, name](const std::string& value) { request->mosaic.push_back(name + "=" + value); }, text)
        ->type_name(type);
  };
  field("--crs", "mosaic.crs", "CRS", "Projected CRS in metres, as GDAL understands it, such as EPSG:32630; default: UTM zone of the area");
  field("--gsd", "mosaic.gsd", "M", "Ground sample distance, m (sensor pixels without telemetry); default: the sensor's / tre.ratio");
  command
      ->add_option_function<std::vector<double>>(
          "--bounds",
          [request](const std::vector<double>& box) {
            constexpr const char* kNames[] = {"x_min", "y_min", "x_max", "y_max"};
            for (std::size_t i = 0; i < 4; ++i) request->mosaic.push_back(fmt::format("mosaic.bounds.{}={}", kNames[i], box[i]));
          },
          "What the mosaic covers, in coordinates of its CRS; default: all that was seen")
      ->expected(4)
      ->delimiter(',')
      ->type_name("X_MIN,Y_MIN,X_MAX,Y_MAX");
  field("--cutline", "mosaic.cutline_path", "FILE", "Polygons (GeoJSON, GeoPackage) outside of which the mosaic is nodata");
  field("--estimator", "mosaic.estimator", "NAME", "weighted_median (default), median or biweight");
  command->add_flag_callback(
      "--baseline", [request] { request->mosaic.push_back("mosaic.baseline=true"); },
      "Also the mosaic at the sensor's resolution of frames placed by image motion alone");
}

std::vector<std::string> OverridesOf(const Request& request) {
  std::vector<std::string> overrides = request.mosaic;
  overrides.insert(overrides.end(), request.overrides.begin(), request.overrides.end());
  return overrides;
}

void AddOverrides(CLI::App* command, Request* request) {
  command->add_option("--set", request->overrides, "Change a field of the spec, for example tre.ratio=2; may be repeated")
      ->type_name("FIELD=VALUE")
      ->allow_extra_args(false);
}

CLI::App* AddRemoteCommand(CLI::App* app, Request* request, const std::string& name, const std::string& description) {
  CLI::App* command = app->add_subcommand(name, description);
  command->add_option("--coordinator", request->remote.coordinator, "Endpoint of the coordinator, for example tcp://127.0.0.1:7411")
      ->envname("TREM_COORDINATOR")
      ->required();
  command->add_option("--key", request->remote.key, "Your .key file (`trem keys`), where the coordinator asks for keys")
      ->envname("TREM_KEY");
  command->add_option("--coordinator-key", request->remote.coordinator_key, "The coordinator's .pub file")->envname("TREM_COORDINATOR_KEY");
  command->add_flag("--json", request->remote.json, "Print JSON");
  command->add_flag("-q,--quiet", request->remote.quiet, "No progress and no summary");
  return command;
}

void AddRunCommand(CLI::App* app, Request* request) {
  CLI::App* command = app->add_subcommand("run", "Make a mosaic of a sortie on this machine");
  RunOptions* run = &request->run;
  run->worker_count = DefaultWorkerCount();
  command->add_option("SORTIE", request->sortie, "A video, a folder or glob of images, or a spec (.textproto, .json)")->required();
  command->add_option("-o,--output", request->output, "The mosaic to write, *.tif; its siblings go beside it")->required();
  command->add_option("--workers", run->worker_count, "Worker processes; default: one a core")
      ->check(CLI::Range(1, kWorkersMax))
      ->type_name("N");
  AddMosaicOptions(command, request);
  AddOverrides(command, request);
  command->add_option("--work-dir", request->work_folder, "Folder for what is needed to resume; default: <output>.work");
  command->add_flag("--keep-work", run->keep_work, "Keep that folder after success");
  command->add_flag("--json", run->json, "Print one JSON object on stdout at the end");
  command->add_flag("-q,--quiet", run->quiet, "No progress and no summary; warnings and errors stay");
  command->footer(
      "Starts a coordinator and workers, waits, stops them. Interrupted or failed, the same command resumes.\n\n"
      "Examples:\n"
      "  trem run flight.ts -o mosaic.tif\n"
      "  trem run frames/ -o out/mosaic.tif --workers 4 --set tre.ratio=2\n"
      "  trem run flight.ts -o mosaic.tif --crs EPSG:32630 --gsd 0.15 --bounds 500000,4200000,500800,4200600\n"
      "  trem run sortie.textproto -o mosaic.tif --json > report.json\n\n"
      "Exit codes: 0 done, 1 failed, 2 usage, 3 invalid input, 5 done in part (the warnings name the holes), 130 interrupted");
  command->callback([request] {
    request->action = [request] {
      request->run.sortie = request->sortie;
      request->run.output = request->output;
      request->run.work_folder = request->work_folder;
      request->run.overrides = OverridesOf(*request);
      return RunRunCommand(request->run);
    };
  });
}

void AddPlanCommand(CLI::App* app, Request* request) {
  CLI::App* command = app->add_subcommand("plan", "Windows, tasks, expected memory and disk of a job; runs nothing");
  command->add_option("SORTIE", request->sortie, "A video, a folder or glob of images, or a spec (.textproto, .json)")->required();
  AddOverrides(command, request);
  command->add_flag("--json", request->json, "Print JSON");
  command->footer("Reads the sortie once.\n\nExamples:\n  trem plan flight.ts\n  trem plan frames/ --set windows.roi_px=151 --json");
  command->callback(
      [request] { request->action = [request] { return RunPlanCommand(request->sortie, request->overrides, request->json); }; });
}

void AddSubmitAndFetch(CLI::App* app, Request* request) {
  CLI::App* submit = AddRemoteCommand(app, request, "submit", "Give a job to a running coordinator and return at once");
  submit->add_option("SORTIE", request->sortie, "A path that the workers can read too, or a spec")->required();
  AddMosaicOptions(submit, request);
  AddOverrides(submit, request);
  submit->add_option("--job-id", request->job_id, "Name of the job, a-z 0-9 -; the same id again is the same job; default: made up");
  submit->add_flag("--upload", request->upload,
                   "Bring the sortie's files to the coordinator, for workers that cannot read them where they are");
  submit->add_option("--priority", request->priority, "-10 to 10: tasks of jobs of a higher one go first")
      ->check(CLI::Range(-10, 10))
      ->capture_default_str();
  submit->footer(
      "Prints the job's id.\n\nExamples:\n  trem submit flight.ts --coordinator tcp://127.0.0.1:7411\n"
      "  JOB=$(trem submit frames/) && trem watch $JOB && trem fetch $JOB -o mosaic.tif");
  submit->callback([request] {
    request->action = [request] {
      return RunSubmitCommand(request->remote, request->sortie, OverridesOf(*request), request->job_id, request->upload, request->priority);
    };
  });
  CLI::App* fetch = AddRemoteCommand(app, request, "fetch", "Copy the results of a job that is done");
  fetch->add_option("JOB", request->job_id, "Id of the job")->required();
  fetch->add_option("-o,--output", request->output, "The mosaic to write, *.tif; its siblings go beside it")->required();
  fetch->add_option("--store", request->store,
                    "The artefact store, if this machine shares it; default: the results come from the coordinator");
  fetch->footer("Examples:\n  trem fetch flight-1a2b3c4d -o mosaic.tif");
  fetch->callback([request] {
    request->action = [request] { return RunFetchCommand(request->remote, request->job_id, request->output, request->store); };
  });
}

void AddDoctorCommand(CLI::App* app, Request* request) {
  CLI::App* command = AddRemoteCommand(app, request, "doctor", "Check programs, machine, keys and, where one is named, the coordinator");
  command->get_option("--coordinator")->required(false);
  command->add_option("--store", request->doctor.store, "An artefact store to look at from here; default: the coordinator's, on S3");
  command->add_option("--service", request->doctor.service, "Service folder of a Slurm installation, to look after its scaler")
      ->envname("TREM_SERVICE");
  command->footer(
      "Says of everything that is wrong what to do; exit code 0 when nothing is.\n\n"
      "Examples:\n  trem doctor\n  trem doctor --coordinator tcp://127.0.0.1:7411\n  trem doctor --store /vsis3/bucket/prefix");
  command->callback([request] { request->action = [request] { return RunDoctorCommand(request->remote, request->doctor); }; });
}

void AddKeysCommand(CLI::App* app, Request* request) {
  CLI::App* command = app->add_subcommand("keys", "Make a key pair, with which machines and people may talk to a coordinator");
  command->add_option("NAME", request->job_id, "Whose key it is, a-z 0-9 -; shown in lists and logs")->required();
  command->add_option("--role", request->role, "coordinator, worker, client (submit, watch, fetch) or admin (also stop and drain)")
      ->required()
      ->check(CLI::IsMember({"coordinator", "worker", "client", "admin"}));
  command->add_option("-o,--output", request->output, "Folder for NAME.key (secret, mode 0600) and NAME.pub; default: here");
  command->footer(
      "The .key file stays where it is used; the .pub file goes into the coordinator's --allow folder (a worker's, client's or admin's)\n"
      "or to everybody who talks to it (the coordinator's).\n\n"
      "Examples:\n  trem keys hill-coordinator --role coordinator -o /etc/trem\n  trem keys cluster --role worker -o keys/");
  command->callback([request] { request->action = [request] { return RunKeysCommand(request->job_id, request->role, request->output); }; });
}

void AddOperatorCommands(CLI::App* app, Request* request) {
  CLI::App* logs =
      AddRemoteCommand(app, request, "logs", "What happened to a job: hand-outs, results, failures, what tasks wrote to stderr");
  logs->add_option("JOB", request->logs.job_id, "Id of the job")->required();
  logs->add_option("--task", request->logs.task, "Only of this task: its title, such as 'enhance window 7', or how its key begins");
  logs->add_option("--attempt", request->logs.attempt, "Only of this attempt")->type_name("N");
  logs->add_option("--worker", request->logs.worker_id, "Only of this worker");
  logs->add_flag("--newest", request->logs.newest, "Only the newest lines, as many as one answer holds");
  logs->add_flag("-f,--follow", request->logs.follow, "Go on until the job ends");
  logs->footer(
      "Logs are bounded: of long jobs the newest lines are left.\n\nExamples:\n  trem logs flight-1a2b3c4d -f\n"
      "  trem logs flight-1a2b3c4d --task 'enhance window 7' --attempt 2");
  logs->callback([request] { request->action = [request] { return RunLogsCommand(request->remote, request->logs); }; });
  CLI::App* top = AddRemoteCommand(app, request, "top", "Jobs and workers of a coordinator, refreshed until interrupted");
  top->add_option("--interval-s", request->top.interval_s, "Seconds between two looks")
      ->check(CLI::Range(0.2, 3600.0))
      ->capture_default_str();
  top->add_flag("--once", request->top.once, "One look, as when the output is no terminal");
  top->footer("Examples:\n  trem top\n  trem top --once --json");
  top->callback([request] { request->action = [request] { return RunTopCommand(request->remote, request->top); }; });
  CLI::App* backup = AddRemoteCommand(app, request, "backup", "Copy the coordinator's log into its backup folder while it goes on");
  backup->add_option("NAME", request->job_id, "Name of the copy, a-z 0-9 -; the same name again is the same copy; default: date and time");
  backup->footer(
      "Needs an admin's key where keys are in use. 'trem-coordinator restore' puts a backup back.\n\n"
      "Examples:\n  trem backup nightly-2026-11-23");
  backup->callback([request] { request->action = [request] { return RunBackupCommand(request->remote, request->job_id); }; });
}

void AddSweepCommand(CLI::App* app, Request* request) {
  CLI::App* sweep = AddRemoteCommand(app, request, "sweep", "Remove from a coordinator's object store (/vsis3/...) what no job has");
  sweep->add_option("--older-than-s", request->older_than_s, "What was put since stays: it may belong to a task that is not done")
      ->check(CLI::Range(60, 31'536'000))
      ->capture_default_str();
  sweep->footer(
      "Needs the store's credentials here, trem-worker beside trem, and an admin's key where keys are in use. A store that is a folder is "
      "swept\n"
      "by its coordinator.\n\nExamples:\n  trem sweep --coordinator tcp://127.0.0.1:7411");
  sweep->callback([request] { request->action = [request] { return RunSweepCommand(request->remote, request->older_than_s); }; });
}

void AddJobCommands(CLI::App* app, Request* request) {
  struct JobCommand {
    const char* name;
    const char* description;
    int (*run)(const RemoteOptions&, const std::string&);
  };
  static constexpr JobCommand kCommands[] = {
      {"status", "A job's stages, results and warnings", RunStatusCommand},
      {"watch", "Show a job's progress until it ends", RunWatchCommand},
      {"cancel", "Stop a job", RunCancelCommand},
      {"retry", "Take up what failed of a job; what is done stays done", RunRetryCommand},
      {"remove", "Forget a job that has ended, with its results in the artefact store", RunRemoveCommand},
  };
  for (const JobCommand& entry : kCommands) {
    CLI::App* command = AddRemoteCommand(app, request, entry.name, entry.description);
    command->add_option("JOB", request->job_id, "Id of the job")->required();
    command->footer(fmt::format("Examples:\n  trem {} flight-1a2b3c4d --coordinator tcp://127.0.0.1:7411", entry.name));
    command->callback([request, run = entry.run] { request->action = [request, run] { return run(request->remote, request->job_id); }; });
  }
  CLI::App* drain = AddRemoteCommand(app, request, "drain", "Let a worker finish what it runs, and leave");
  drain->add_option("WORKER", request->job_id, "Id of the worker, as 'trem workers' shows it")->required();
  drain->footer("Needs an admin's key where keys are in use.\n\nExamples:\n  trem drain node-7-4711-0a1b2c3d");
  drain->callback([request] { request->action = [request] { return RunDrainCommand(request->remote, request->job_id); }; });
  AddOperatorCommands(app, request);
  AddSweepCommand(app, request);
  CLI::App* list = AddRemoteCommand(app, request, "list", "All jobs of a coordinator");
  list->footer("Examples:\n  trem list --coordinator tcp://127.0.0.1:7411");
  list->callback([request] { request->action = [request] { return RunListCommand(request->remote); }; });
  CLI::App* workers = AddRemoteCommand(app, request, "workers", "All workers of a coordinator");
  workers->footer("Examples:\n  trem workers --coordinator tcp://127.0.0.1:7411 --json");
  workers->callback([request] { request->action = [request] { return RunWorkersCommand(request->remote); }; });
}

std::vector<std::string> CommandNames(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) names.push_back(command->get_name());
  return names;
}

// The options of the command that was being parsed, as "--workers".
std::vector<std::string> OptionNames(const CLI::App& app) {
  std::vector<std::string> names;
  const std::vector<CLI::App*> parsed = app.get_subcommands();
  const CLI::App& command = parsed.empty() ? app : *parsed.front();
  for (const CLI::Option* option : command.get_options()) {
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  }
  return names;
}

int ReportUnknownCommand(const CLI::App& app, const std::string& word) {
  const std::string suggestion = DidYouMean(word, CommandNames(app));
  PrintError("'" + word + "' is not a command of trem" + (suggestion.empty() ? "." : suggestion) + " See 'trem --help'");
  return kExitUsage;
}

int ReportParseError(const CLI::App& app, const CLI::ParseError& error, int argc, char** argv) {
  std::string message = error.what();
  if (dynamic_cast<const CLI::ExtrasError*>(&error) != nullptr) {
    const std::vector<std::string> known = OptionNames(app);
    for (int i = 2; i < argc; ++i) {
      const std::string word = std::string(argv[i]).substr(0, std::string(argv[i]).find('='));
      if (word.size() < 3 || word.compare(0, 2, "--") != 0 || std::find(known.begin(), known.end(), word) != known.end()) continue;
      message = "unknown option " + word + DidYouMean(word, known);
      break;
    }
  }
  const std::vector<CLI::App*> parsed = app.get_subcommands();
  if (message.empty() || message.back() != '?') message += '.';
  PrintError(message + " See 'trem " + (parsed.empty() ? "" : parsed.front()->get_name() + " ") + "--help'");
  return kExitUsage;
}

}  // namespace

int RunTrem(int argc, char** argv) {
  const std::string first = argc > 1 ? argv[1] : "";
  for (const WorkerCommand& command : kWorkerCommands) {
    if (first == command.name) return ExecWorker(argc, argv);
  }
  Request request;
  CLI::App app("trem: resolution-enhanced, georeferenced median mosaics from airborne video", "trem");
  app.set_version_flag("--version", fmt::format("trem {} (engine revision {})", TREM_VERSION, kEngineRevision));
  app.footer(
      "Examples:\n  trem run flight.ts -o mosaic.tif\n  trem inspect frames/\n\n'trem COMMAND --help' explains a command.\n"
      "Exit codes: 0 done, 1 failed, 2 usage, 3 invalid input, 4 coordinator not reachable, 5 done in part");
  AddRunCommand(&app, &request);
  AddPlanCommand(&app, &request);
  for (const WorkerCommand& command : kWorkerCommands) app.add_subcommand(command.name, command.description);
  AddSubmitAndFetch(&app, &request);
  AddJobCommands(&app, &request);
  AddKeysCommand(&app, &request);
  AddDoctorCommand(&app, &request);
  if (first.empty()) {
    fmt::print(stderr, "{}", app.help());
    return kExitUsage;
  }
  const std::vector<std::string> names = CommandNames(app);
  if (first[0] != '-' && std::find(names.begin(), names.end(), first) == names.end()) return ReportUnknownCommand(app, first);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {  // --help, --version.
    app.exit(success);
    return kExitDone;
  } catch (const CLI::ParseError& error) {
    return ReportParseError(app, error, argc, argv);
  }
  if (!request.action) return ReportUnknownCommand(app, first);
  return request.action();
}

}  // namespace trem
