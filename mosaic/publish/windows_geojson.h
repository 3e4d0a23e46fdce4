#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "mosaic/base/status.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// One emitted scene as it lies on the ground.
struct SceneFootprint {
  std::uint32_t window_id = 0;
  std::uint32_t scene_id = 0;
  std::uint32_t piece = 0;
  Homography world_from_scene;
  Roi raster_in_scene;
  Roi roi_in_sensor;
  std::uint32_t frame_begin = 0;  // Manifest frames [frame_begin, frame_end) whose samples dominate it.
  std::uint32_t frame_end = 0;
  double position_sigma = 0.0;
  double gain = 1.0;
  double offset = 0.0;
};

// Writes mosaic_windows.geojson: a FeatureCollection of one Polygon a scene, in the span's order. Georeferenced: RFC 7946, longitude and
// latitude (WGS 84, rounded to 1e-9 deg), exterior rings counter-clockwise. Not georeferenced: the same geometry in the local engineering
// coordinates of the mosaic, which RFC 7946 does not know; the collection and every feature say so in "coordinate_reference". A footprint
// that the horizon cuts so that it leaves the map has a null geometry. Streams to `path`.
Status WriteWindowsGeoJson(const std::filesystem::path& path, std::span<const SceneFootprint> scenes, const std::string& crs_wkt,
                           bool georeferenced);

}  // namespace trem
