#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "mosaic/align/frames_and_scenes.h"
#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// An ALIGN task's messages as domain types.
struct AlignTaskInput {
  align::AlignInput align;
  std::map<std::pair<std::uint32_t, std::uint32_t>, ArtefactRef> rasters;  // By (window, scene).
  bool telemetry = false;                                                  // Some frame has an anchor.
  std::string crs_wkt;                                                     // Of the map; local without telemetry.
  Homography map_from_working;                                             // Scale and shift: map = origin + scale factor * working.
  double scale = 1.0;                                                      // Map units per working unit.
  std::vector<v1::Note> notes;
};

// Validates and converts. `windows` in any order. kCorrupt names the window and field at fault; kInvalidInput for an unusable mosaic.crs.
//
// The working world (see mosaic/align): map coordinates minus an origin near the first frames, divided by the projection's scale
// factor there, so that it is metric; yaw is turned from true to grid north. The Earth's curvature below one footprint is neglected
// (2 cm over 1 km).
Result<AlignTaskInput> MakeAlignInput(const v1::Sortie& sortie, const v1::SortieManifest& manifest,
                                      const std::vector<v1::WindowResult>& windows);

v1::Note MakeNote(const std::string& code, const std::string& subject, const std::string& message, v1::Severity severity);

}  // namespace trem
