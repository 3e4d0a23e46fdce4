#include "worker/app/store_commands.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "mosaic/raster/vsi_backing.h"
#include "mosaic/raster/vsi_sweep.h"
#include "worker/app/scratch_folder.h"
#include "worker/app/usage.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr std::uint64_t kListBytesMax = std::uint64_t{1} << 32;

Status CheckStore(const std::string& store) {
  TREM_RETURN_IF_ERROR(VsiBacking(store).Check());
  TREM_ASSIGN_OR_RETURN(const ScratchFolder scratch, ScratchFolder::Make(fs::temp_directory_path() / "trem"));
  const std::string text = "trem check-store was here\n";
  const ArtefactRef ref{"check", Sha256Hex(text), text.size()};
  TREM_RETURN_IF_ERROR(WriteFileAtomically(scratch.path() / "there", text));
  TREM_RETURN_IF_ERROR(VsiBacking(store).Deliver(ref, scratch.path() / "there"));
  TREM_RETURN_IF_ERROR(VsiBacking(store).Fetch(ref, scratch.path() / "back").status());
  TREM_ASSIGN_OR_RETURN(const std::string back, ReadFile(scratch.path() / "back", text.size() + 1));
  return back == text ? Status() : Corrupt("the store " + store + " gives other bytes back than it was given");
}

Result<SweepReport> SweepStore(const std::string& store, const std::string& in_use_path, const std::string& owner,
                               const SweepOptions& options) {
  TREM_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(in_use_path, kListBytesMax));
  TREM_ASSIGN_OR_RETURN(std::vector<std::string> in_use, UnpackDigests(bytes));
  TREM_RETURN_IF_ERROR(ClaimVsiStore(store, owner));
  return SweepVsiStore(store, SweepRule(std::move(in_use), {}, options));
}

}  // namespace

int RunCheckStoreCommand(int argc, char** argv) {
  std::string store;
  CLI::App app("Puts a small object into an artefact store and gets it back.", "trem-worker check-store");
  app.add_option("--store", store, "/vsis3/BUCKET/PREFIX or another of GDAL's virtual paths")->required();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  const Status status = CheckStore(store);
  if (!status.ok()) std::cerr << "trem-worker: " << status.message() << "\n";
  return ExitCodeOf(status);
}

int RunSweepStoreCommand(int argc, char** argv) {
  std::string store, in_use, owner;
  SweepOptions options;
  std::int64_t stay_s = options.new_objects_stay.count();
  CLI::App app("Removes from an artefact store in an object store what no job has; `trem sweep` runs it.", "trem-worker sweep-store");
  app.add_option("--store", store, "/vsis3/BUCKET/PREFIX or another of GDAL's virtual paths")->required();
  app.add_option("--in-use", in_use, "File of the digests that some job has, 32 bytes each")->required();
  app.add_option("--owner", owner, "Id of the coordinator whose store it is")->required();
  app.add_option("--older-than-s", stay_s, "Younger objects stay")->check(CLI::Range(0, 31'536'000))->capture_default_str();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  options.new_objects_stay = std::chrono::seconds(stay_s);
  const Result<SweepReport> report = SweepStore(store, in_use, owner, options);
  if (!report.ok()) {
    std::cerr << "trem-worker: " << report.status().message() << "\n";
    return ExitCodeOf(report.status());
  }
  fmt::print("{} {} {}\n", report->removed_objects, report->removed_bytes, report->bytes);
  return kExitDone;
}

}  // namespace trem
