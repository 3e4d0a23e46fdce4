#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// The elevation model around the places that records name, over longitude and latitude: coarse, for the audit. kInvalidInput and the like
// as ReadElevationModel, and when no record names a place.
Result<GriddedGround> GroundAround(const std::string& dem_path, const std::vector<TelemetryRecord>& records);

// Cuts the elevation model to what the frames of `manifest` see (rays of the image's corners and centre meet the surface; 10 % margin),
// keeps it in manifest.ground, and takes the median elevation seen for manifest.ground_elevation_m. kInvalidInput when it does not cover
// that or no frame sees it. Without any frame that has a pose or corners nothing happens.
Status AttachGround(const std::string& dem_path, v1::SortieManifest* manifest);

// manifest.ground as a surface over longitude and latitude; nothing when the ground is level. kCorrupt when it is no grid.
Result<std::optional<GriddedGround>> GroundOfManifest(const v1::SortieManifest& manifest);

}  // namespace trem
