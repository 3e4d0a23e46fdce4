#pragma once

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/planar_map.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What the outputs of `trem enhance` are made from.
struct EnhancedWindow {
  const v1::SortieManifest* manifest = nullptr;
  const v1::WindowResult* window = nullptr;
  const ArtefactStore* store = nullptr;  // Holds the window's scene rasters.
  int ratio = 3;                         // Scene cells per sensor pixel.
};

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

// Of a scene raster; the engine's buffers are far smaller.
inline constexpr long long kScenePixelsMax = 1LL << 28;

// The scene's intensity at `pixel`, NaN where a cell that it is made of was never seen.
float SampleSeen(const SceneRaster& scene, const Eigen::Vector2d& pixel);

// Pixels of the scene's raster from sensor pixels of the view's frame. kCorrupt when the view's map is not one.
Result<PlanarMap> PixelFromSensor(const v1::ChainView& view, const v1::EmittedScene& scene);

}  // namespace trem
