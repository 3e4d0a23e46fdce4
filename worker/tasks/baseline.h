#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/composite/tile_compositor.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// The mosaic that this project's is compared with: whole frames at the sensor's resolution, placed by nothing but the motion from each
// to the next, and their median.

// A whole frame on the ground.
struct FramePlacement {
  int index = 0;  // In the manifest.
  Homography world_from_sensor;
  double gain = 1.0;  // frame = gain * balanced + offset, internal grey levels, as the alignment found it.
  double offset = 0.0;
};

// Chains frames by their whole-image motion (ManifestFrame.previous_from_current). A chain begins where there is no such motion, with
// the affine part of where the alignment puts that frame, or the first one after it that it puts anywhere; frames before are left out.
// Errors accumulate along a chain: that is the point of it.
Result<std::vector<FramePlacement>> ChainPlacements(const v1::SortieManifest& manifest, const v1::Alignment& alignment);

// Where the alignment puts frames; the first piece of a frame that is in several.
Result<std::vector<FramePlacement>> AlignedPlacements(const v1::Alignment& alignment);

// Of `frames`, those that a mosaic needs: one after an eighth of the image's shorter side of motion, and every 25th where the camera
// stands, so that about eight to sixteen see each piece of ground.
std::vector<FramePlacement> ThinnedOut(const std::vector<FramePlacement>& frames, const v1::SortieManifest& manifest);

// The mosaic's grid at the sensor's resolution: same upper left corner and CRS, pixels `ratio` times as wide.
MosaicGrid SensorGrid(const MosaicGrid& grid, int ratio);

// Composes whole frames. Their pixels wait in temporary files of the store, 8 B a pixel before compression, removed with the object;
// at most one frame is in memory beside the compositor's stack.
class FrameMosaic {
 public:
  // What is lent must outlive the object.
  FrameMosaic(const v1::SortieManifest& manifest, const ArtefactStore& store, std::vector<FramePlacement> frames);
  ~FrameMosaic();
  FrameMosaic(const FrameMosaic&) = delete;
  FrameMosaic& operator=(const FrameMosaic&) = delete;

  // Reads the frames that reach the rectangles of `grid`, once, in order. Call before Compose.
  Status Read(const MosaicGrid& grid, const std::vector<Roi>& rois_in_mosaic, const std::function<bool(double)>& progress);
  // The weighted median of the frames read, in grey levels of the source.
  Result<CompositeTile> Compose(const MosaicGrid& grid, const Roi& roi_in_mosaic, const std::function<bool(double)>& progress) const;

 private:
  const v1::SortieManifest& manifest_;
  const ArtefactStore& store_;
  std::vector<FramePlacement> frames_;
  std::vector<CompositeScene> scenes_;
  std::vector<std::filesystem::path> files_;  // Empty: not read.
};

}  // namespace trem
