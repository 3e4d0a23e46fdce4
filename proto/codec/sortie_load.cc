// LoadSortie: from what a user typed to a complete spec.
#include <fmt/format.h>
#include <glob.h>

#include <filesystem>
#include <optional>
#include <system_error>

#include "mosaic/base/file.h"
#include "proto/codec/sortie_paths.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kSpecFileBytesMax = std::uint64_t{1} << 20;
// Of an override that adds a recording instead of changing a field.
constexpr std::string_view kMorePrefix = "more=";

bool Exists(const fs::path& path) {
  if (path.string().starts_with("/vsi")) return true;  // GDAL's virtual paths: whoever opens them will see.
  std::error_code ignored;
  return fs::exists(path, ignored);
}

bool IsGlob(const std::string& path) { return path.find_first_of("*?[") != std::string::npos; }

bool GlobMatches(const std::string& pattern) {
  glob_t matches{};
  const bool found = ::glob(pattern.c_str(), GLOB_NOSORT, nullptr, &matches) == 0 && matches.gl_pathc > 0;
  ::globfree(&matches);
  return found;
}

std::string WorkingFolder() {
  std::error_code ignored;
  return fs::current_path(ignored).string();
}

std::string Absolute(const std::string& path, const fs::path& base) {
  std::string normal = (base / path).lexically_normal().string();
  if (normal.size() > 1 && normal.ends_with('/')) normal.pop_back();
  return normal;
}

// Makes the paths of a spec absolute; `base` is an absolute folder.
void MakeAbsolute(const fs::path& base, v1::Sortie* sortie) {
  for (const SortiePath& named : PathsOf(sortie)) *named.path = Absolute(*named.path, base);
}

// Ok when `path` is there: something readable, or a glob that matches something.
Status CheckThere(const std::string& field, const std::string& path, const std::string& expected) {
  if (Exists(path) || (IsGlob(path) && GlobMatches(path))) return {};
  const char* what = IsGlob(path) ? "nothing matches the glob" : "no such file or folder";
  return NotFound(fmt::format("{}{}: {}; expected {}", field, what, path, expected));
}

Status CheckSource(const v1::Source& source) {
  TREM_RETURN_IF_ERROR(CheckThere("source.path: ", source.path(), "a video, a folder of images or a glob"));
  std::error_code error;
  if (!fs::is_directory(source.path(), error)) return {};
  const bool empty = fs::is_empty(source.path(), error);
  if (error) return InvalidInput(fmt::format("source.path: cannot list the folder {}: {}", source.path(), error.message()));
  if (empty) return NotFound(fmt::format("source.path: the folder {} is empty; expected images in it", source.path()));
  return {};
}

Status CheckRecording(const v1::Source& source, const v1::Telemetry& telemetry) {
  TREM_RETURN_IF_ERROR(CheckSource(source));
  if (!telemetry.path().empty() && !telemetry.ignore()) {
    TREM_RETURN_IF_ERROR(CheckThere("telemetry.path: ", telemetry.path(), "a telemetry.csv, .srt or .gpx file"));
  }
  return telemetry.dem_path().empty() ? Status() : CheckThere("telemetry.dem_path: ", telemetry.dem_path(), "an elevation model");
}

// A spec file's sortie with its paths made absolute, or one of a source.
Result<v1::Sortie> ReadSortie(const std::string& argument, const std::string& folder) {
  v1::Sortie sortie;
  std::error_code ignored;
  if ((argument.ends_with(".textproto") || argument.ends_with(".json")) && fs::is_regular_file(argument, ignored)) {
    TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(argument, kSpecFileBytesMax));
    TREM_ASSIGN_OR_RETURN(sortie, ParseSortieSpec(text, argument));
    MakeAbsolute(fs::path(Absolute(argument, folder)).parent_path(), &sortie);
  } else {
    sortie.mutable_source()->set_path(argument);
  }
  return sortie;
}

Status CheckSensorFiles(const v1::Sensor& sensor) {
  const auto check = [](const std::string& field, const std::string& path, const std::string& expected) {
    return path.empty() ? Status() : CheckThere(field, path, expected);
  };
  TREM_RETURN_IF_ERROR(check("sensor.psf_kernel_path: ", sensor.psf_kernel_path(), "a kernel as text or raster"));
  TREM_RETURN_IF_ERROR(check("sensor.bad_pixel_path: ", sensor.bad_pixel_path(), "a PNG or TIFF of the sensor's size"));
  return check("sensor.mask_path: ", sensor.mask_path(), "a PNG or TIFF of the sensor's size");
}

}  // namespace

Result<v1::Sortie> LoadSortie(const std::string& argument, const std::vector<std::string>& overrides) {
  if (argument.empty()) return InvalidInput("no sortie given; expected a sortie spec, a video, a folder of images or a glob");
  const std::string folder = WorkingFolder();
  if (!Exists(argument) && !(IsGlob(argument) && GlobMatches(argument))) {
    return NotFound(fmt::format("{}: {} (looked from {}); expected a sortie spec, a video, a folder of images or a glob",
                                IsGlob(argument) ? "nothing matches the glob" : "no such file or folder", argument, folder));
  }
  TREM_ASSIGN_OR_RETURN(v1::Sortie sortie, ReadSortie(argument, folder));
  for (const std::string& assignment : overrides) {
    if (!assignment.starts_with(kMorePrefix)) {
      TREM_RETURN_IF_ERROR(ApplyOverride(assignment, &sortie));
      continue;
    }
    const std::string path = assignment.substr(kMorePrefix.size());
    TREM_RETURN_IF_ERROR(CheckThere("--set more: ", path, "a sortie spec, a video, a folder of images or a glob"));
    TREM_ASSIGN_OR_RETURN(const v1::Sortie other, ReadSortie(path, folder));
    *sortie.add_more()->mutable_source() = other.source();
    *sortie.mutable_more(sortie.more_size() - 1)->mutable_telemetry() = other.telemetry();
    for (const v1::Recording& recording : other.more()) *sortie.add_more() = recording;
  }
  MakeAbsolute(folder, &sortie);  // Paths typed on the command line.
  TREM_RETURN_IF_ERROR(CompleteSortie(&sortie).WithPrefix(argument));
  TREM_RETURN_IF_ERROR(CheckRecording(sortie.source(), sortie.telemetry()));
  for (int k = 0; k < sortie.more_size(); ++k) {
    TREM_RETURN_IF_ERROR(CheckRecording(sortie.more(k).source(), sortie.more(k).telemetry()).WithPrefix(fmt::format("more[{}]", k)));
  }
  if (!sortie.control().path().empty()) TREM_RETURN_IF_ERROR(CheckThere("control.path: ", sortie.control().path(), "a gcp.csv"));
  TREM_RETURN_IF_ERROR(CheckSensorFiles(sortie.sensor()));
  if (!sortie.mosaic().cutline_path().empty()) {
    TREM_RETURN_IF_ERROR(CheckThere("mosaic.cutline_path: ", sortie.mosaic().cutline_path(), "polygons as GeoJSON or GeoPackage"));
  }
  return sortie;
}

}  // namespace trem
