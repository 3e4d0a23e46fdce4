#include "worker/tasks/export_stac.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <limits>
#include <utility>
#include <vector>

#include "mosaic/base/version.h"
#include "mosaic/publish/stac_item.h"

namespace trem {
namespace {

constexpr const char* kCogType = "image/tiff; application=geotiff; profile=cloud-optimized";

struct FileKind {
  const char* name;
  const char* key;
  const char* title;
  const char* type;
  std::vector<std::string> roles;
};

const std::vector<FileKind>& FileKinds() {
  static const auto* const kinds = new std::vector<FileKind>{
      {"mosaic.tif", "mosaic", "Mosaic", kCogType, {"data"}},
      {"mosaic_quality.tif", "quality", "Count, spread and position error of every pixel", kCogType, {"metadata"}},
      {"mosaic_source.tif", "source", "Window that dominates each pixel", kCogType, {"metadata"}},
      {"mosaic_baseline.tif", "baseline", "Median of frames placed by image motion alone", kCogType, {"data"}},
      {"mosaic_chain.csv", "chain", "Every frame's transform, gain, offset and residual", "text/csv", {"metadata"}},
      {"mosaic_windows.geojson", "windows", "Footprints of the scenes", "application/geo+json", {"metadata"}},
      {"mosaic_report.html", "report", "Report", "text/html", {"metadata"}},
      {"mosaic_preview.png", "preview", "Preview", "image/png", {"overview", "thumbnail"}}};
  return *kinds;
}

std::vector<StacBand> BandsOf(const std::string& name, const StacSource& source) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const std::string unit = source.alignment.georeferenced() ? "m" : "pixel";
  if (name == "mosaic.tif") {
    const double nodata = source.mosaic_type == "float32" ? kNan : 0.0;
    return {{source.report.estimator + ", grey levels of the source", "", source.mosaic_type, nodata}};
  }
  if (name == "mosaic_baseline.tif") return {{"median, grey levels of the source", "", "float32", kNan}};
  if (name == "mosaic_source.tif") return {{"window id of the dominant scene", "", "int32", -1.0}};
  if (name != "mosaic_quality.tif") return {};
  return {{"count of scenes", "", "float32", kNan},
          {"NMAD between scenes, grey levels of the source", "", "float32", kNan},
          {"standard error of position", unit, "float32", kNan}};
}

// Lower case, with hyphens for what is neither letter, digit, point nor underscore.
std::string IdOf(const std::string& name) {
  std::string id;
  for (const char c : name) {
    const auto byte = static_cast<unsigned char>(c);
    id += byte < 0x80 && (std::isalnum(byte) != 0 || c == '.' || c == '_') ? static_cast<char>(std::tolower(byte)) : '-';
  }
  return id.empty() ? "mosaic" : id;
}

}  // namespace

Result<std::string> MakeStacItem(const StacSource& source, const v1::TaskResult& result) {
  StacItem item;
  item.id = IdOf(source.report.sortie);
  item.title = source.report.sortie;
  item.description = fmt::format("Resolution-enhanced mosaic of {} of {} frames of {}", source.report.registered_count,
                                 source.report.frame_count, source.report.sortie);
  if (!source.alignment.georeferenced()) item.description += "; local coordinates, no place on Earth";
  item.grid = source.grid;
  item.georeferenced = source.alignment.georeferenced();
  for (const v1::ManifestFrame& frame : source.manifest.frames()) {
    if (!frame.has_utc_us()) continue;
    const double utc_s = 1e-6 * static_cast<double>(frame.utc_us());
    item.start_s = std::min(item.start_s.value_or(utc_s), utc_s);
    item.end_s = std::max(item.end_s.value_or(utc_s), utc_s);
  }
  item.software = "trem";
  item.version = std::string(TREM_VERSION) + ", engine " + kEngineRevision;
  item.lineage =
      "Frames registered and enhanced in windows of the sensor, aligned in one adjustment, composed by the " + source.report.estimator;
  for (const FileKind& kind : FileKinds()) {
    const auto output =
        std::find_if(result.outputs().begin(), result.outputs().end(), [&](const v1::ArtefactRef& ref) { return ref.name() == kind.name; });
    if (output == result.outputs().end()) continue;
    StacAsset asset{kind.name, kind.key, kind.title, kind.type, kind.roles, output->sha256(), output->bytes(), BandsOf(kind.name, source),
                    {}};
    if (asset.name == "mosaic_report.html") asset.sha256.clear();
    if (asset.name == "mosaic_baseline.tif") asset.grid = source.sensor_grid;
    item.assets.push_back(std::move(asset));
  }
  return StacItemJson(item);
}

}  // namespace trem
