#include "mosaic/publish/windows_geojson.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "mosaic/geometry/footprint.h"
#include "mosaic/raster/crs.h"

namespace trem {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kGeographicNote = "WGS 84 longitude, latitude";
constexpr const char* kLocalNote = "local engineering coordinates of the mosaic, not longitude and latitude: no usable telemetry";

double Rounded(double value) { return std::round(value * 1e9) / 1e9; }

double SignedArea(const std::vector<Eigen::Vector2d>& ring) {
  double twice = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Eigen::Vector2d& a = ring[i];
    const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
    twice += a.x() * b.y() - a.y() * b.x();
  }
  return 0.5 * twice;
}

// Exterior ring of the scene's footprint, counter-clockwise, not closed.
Result<std::vector<Eigen::Vector2d>> Ring(const SceneFootprint& scene, const std::optional<UtmFrame>& frame) {
  const Roi& raster = scene.raster_in_scene;
  const Eigen::Vector2d centre(0.5 * (raster.x0 + raster.x1 - 1), 0.5 * (raster.y0 + raster.y1 - 1));
  TREM_ASSIGN_OR_RETURN(const Homography world_from_scene, NormalisedAt(scene.world_from_scene, centre));
  std::vector<Eigen::Vector2d> ring = ProjectRoi(world_from_scene, raster);
  if (frame) {
    for (Eigen::Vector2d& point : ring) {
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d latitude_longitude, frame->Inverse(point));
      point = {latitude_longitude.y(), latitude_longitude.x()};
    }
  }
  if (SignedArea(ring) < 0.0) std::reverse(ring.begin(), ring.end());
  return ring;
}

Json Geometry(const SceneFootprint& scene, const std::optional<UtmFrame>& frame) {
  const Result<std::vector<Eigen::Vector2d>> ring = Ring(scene, frame);
  // A scene that sees the horizon reaches farther than any map projection: RFC 7946 calls such a feature unlocated.
  if (!ring.ok() || ring->size() < 3) return nullptr;
  Json coordinates = Json::array();
  for (std::size_t i = 0; i <= ring->size(); ++i) {
    const Eigen::Vector2d& point = (*ring)[i % ring->size()];
    coordinates.push_back({Rounded(point.x()), Rounded(point.y())});
  }
  return {{"type", "Polygon"}, {"coordinates", Json::array({coordinates})}};
}

Json Feature(const SceneFootprint& scene, const std::optional<UtmFrame>& frame) {
  Json feature;
  feature["type"] = "Feature";
  feature["geometry"] = Geometry(scene, frame);
  Json& properties = feature["properties"];
  properties["window"] = scene.window_id;
  properties["scene"] = scene.scene_id;
  properties["piece"] = scene.piece;
  properties["frame_begin"] = scene.frame_begin;
  properties["frame_end"] = scene.frame_end;
  properties["roi_in_sensor"] = {scene.roi_in_sensor.x0, scene.roi_in_sensor.y0, scene.roi_in_sensor.x1, scene.roi_in_sensor.y1};
  properties["position_sigma"] = scene.position_sigma;
  properties["gain"] = scene.gain;
  properties["offset"] = scene.offset;
  properties["coordinate_reference"] = frame ? kGeographicNote : kLocalNote;
  return feature;
}

}  // namespace

Status WriteWindowsGeoJson(const std::filesystem::path& path, std::span<const SceneFootprint> scenes, const std::string& crs_wkt,
                           bool georeferenced) {
  std::optional<UtmFrame> frame;
  if (georeferenced) {
    TREM_ASSIGN_OR_RETURN(UtmFrame made, UtmFrame::ForCrs(crs_wkt));
    frame = std::move(made);
  }
  std::ofstream stream(path, std::ios::binary | std::ios::trunc);
  if (!stream) return FromErrno("cannot create " + path.string(), errno);
  stream << "{\"type\":\"FeatureCollection\",\n\"coordinate_reference\":" << Json(frame ? kGeographicNote : kLocalNote).dump()
         << ",\n\"features\":[";
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    stream << (i == 0 ? "\n" : ",\n") << Feature(scenes[i], frame).dump();
  }
  stream << "\n]}\n";
  stream.close();
  if (stream.fail()) return FromErrno("cannot write " + path.string(), errno);
  return {};
}

}  // namespace trem
