#include "worker/app/inspect_command.h"
#include "mosaic/base/exit_code.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <opencv2/core.hpp>
#include <string>
#include <utility>
#include <vector>

#include "mosaic/base/file.h"
#include "mosaic/base/parallel.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_spec.h"
#include "worker/app/progress_bar.h"
#include "worker/app/sortie_report.h"
#include "worker/app/usage.h"
#include "worker/tasks/describe_sortie.h"
#include "worker/tasks/merge_recordings.h"

namespace trem {
namespace {

constexpr const char* kExamples =
    "\nExamples:\n"
    "  trem inspect flight.ts                               a video\n"
    "  trem inspect frames/                                 a folder of images, with its telemetry.csv\n"
    "  trem inspect sortie.textproto --set source.max_frames=100\n"
    "  trem inspect 'frames/*.png' --json\n"
    "  trem inspect flight.ts --set more=second.ts          two recordings, one after the other\n";

struct Arguments {
  std::string sortie;
  std::vector<std::string> overrides;
  std::string manifest_path;
  bool json = false;
  bool quiet = false;
};

// The manifests of all recordings, in order.
Result<std::vector<v1::SortieManifest>> Ingest(const Arguments& arguments, const v1::Sortie& sortie) {
  ProgressBar bar("reading", arguments.quiet);
  const int count = 1 + sortie.more_size();
  std::vector<v1::SortieManifest> manifests;
  try {
    for (int k = 0; k < count; ++k) {
      const auto show = [&](double fraction) {
        bar.Show((k + fraction) / count);
        return true;
      };
      Result<v1::SortieManifest> manifest = DescribeSortie(SortieOfRecording(sortie, k), show, ProcessorCount());
      if (!manifest.ok()) return k == 0 ? manifest.status() : manifest.status().WithPrefix(fmt::format("more[{}]", k - 1));
      manifests.push_back(std::move(*manifest));
    }
    return manifests;
  } catch (const cv::Exception& exception) {
    return Failed(std::string("OpenCV: ") + exception.what());
  } catch (const std::bad_alloc&) {
    return Exhausted(arguments.sortie + ": not enough memory for its frames");
  }
}

Status Inspect(const Arguments& arguments) {
  TREM_ASSIGN_OR_RETURN(const v1::Sortie sortie, LoadSortie(arguments.sortie, arguments.overrides));
  TREM_ASSIGN_OR_RETURN(const std::vector<v1::SortieManifest> manifests, Ingest(arguments, sortie));
  // Whether one mosaic can be made of them is said here, too.
  TREM_ASSIGN_OR_RETURN(const MergedRecordings merged, MergeRecordings(sortie, manifests));
  if (!arguments.manifest_path.empty()) {
    TREM_RETURN_IF_ERROR(WriteFileAtomically(arguments.manifest_path, SerializeDeterministic(merged.all)));
  }
  std::vector<SortieReport> reports;
  for (const v1::SortieManifest& manifest : manifests) reports.push_back(ReportOn(manifest));
  fmt::print("{}", arguments.json ? FormatReportsAsJson(manifests, reports) : FormatReports(manifests, reports));
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
