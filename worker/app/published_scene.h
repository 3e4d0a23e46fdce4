#pragma once

#include "mosaic/base/status.h"
#include "mosaic/geometry/planar_map.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// The scene that is published and the frame that it is related to.
struct PublishedScene {
  const v1::Segment* segment = nullptr;
  const v1::EmittedScene* scene = nullptr;
  const v1::ChainView* reference = nullptr;
  PlanarMap pixel_from_sensor;  // Pixels of the scene raster from sensor pixels of the reference frame.
};

// Source grey level = offset + scale * internal intensity.
struct GreyScale {
  double offset = 0.0;
  double scale = 1.0;
  double Source(double internal) const { return offset + scale * internal; }
};

// Pixels of the scene's raster from sensor pixels of the view's frame. kCorrupt when the view's map is not one.
Result<PlanarMap> PixelFromSensor(const v1::ChainView& view, const v1::EmittedScene& scene);

}  // namespace trem
