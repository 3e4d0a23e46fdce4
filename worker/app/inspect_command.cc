#include "worker/app/inspect_command.h"
#include "mosaic/base/exit_code.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "mosaic/base/file.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_spec.h"
#include "worker/app/progress_bar.h"
#include "worker/app/sortie_report.h"
#include "worker/app/usage.h"
#include "worker/tasks/describe_sortie.h"

namespace trem {
namespace {

constexpr const char* kExamples =
    "\nExamples:\n"
    "  trem inspect flight.ts                               a video\n"
    "  trem inspect frames/                                 a folder of images, with its telemetry.csv\n"
    "  trem inspect sortie.textproto --set source.max_frames=100\n"
    "  trem inspect 'frames/*.png' --json\n";

struct Arguments {
  std::string sortie;
  std::vector<std::string> overrides;
  std::string manifest_path;
  bool json = false;
  bool quiet = false;
};

Result<v1::SortieManifest> Ingest(const Arguments& arguments) {
  TREM_ASSIGN_OR_RETURN(const v1::Sortie sortie, LoadSortie(arguments.sortie, arguments.overrides));
  ProgressBar bar("reading", arguments.quiet);
  try {
    return DescribeSortie(sortie, [&bar](double fraction) {
      bar.Show(fraction);
      return true;
    });
  } catch (const cv::Exception& exception) {
    return Failed(std::string("OpenCV: ") + exception.what());
  } catch (const std::bad_alloc&) {
    return Exhausted(arguments.sortie + ": not enough memory for its frames");
  }
}

Status Inspect(const Arguments& arguments) {
  TREM_ASSIGN_OR_RETURN(const v1::SortieManifest manifest, Ingest(arguments));
  if (!arguments.manifest_path.empty()) {
    TREM_RETURN_IF_ERROR(WriteFileAtomically(arguments.manifest_path, SerializeDeterministic(manifest)));
  }
  const SortieReport report = ReportOn(manifest);
  fmt::print("{}", arguments.json ? FormatReportAsJson(manifest, report) : FormatReport(manifest, report));
  return {};
}

}  // namespace

int RunInspectCommand(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Says what a sortie holds: frames, sizes, rate, telemetry, footprint, gaps, cuts and suspicious values.", "trem inspect");
  app.add_option("SORTIE", arguments.sortie, "A spec (.textproto, .json), a video, a folder of images, or a glob")->required();
  app.add_option("--set", arguments.overrides, "Override a field of the spec, for example source.max_frames=100")->allow_extra_args(false);
  app.add_option("--manifest", arguments.manifest_path, "Write the manifest (protobuf trem.v1.SortieManifest) to this file too");
  app.add_flag("--json", arguments.json, "Print the report as JSON");
  app.add_flag("-q,--quiet", arguments.quiet, "No progress");
  app.footer(kExamples);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  const Status status = Inspect(arguments);
  if (!status.ok()) fmt::print(stderr, "trem inspect: {}\n", status.message());
  return ExitCodeOf(status);
}

}  // namespace trem
