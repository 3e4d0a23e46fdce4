#pragma once

#include <filesystem>
#include <optional>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// An emitted scene on disk: a tiled TIFF of two or four float32 bands without georeference. Its place on the ground is the alignment's.
struct SceneRaster {
  Image<float> intensity;    // Internal grey levels.
  Image<float> information;  // Equivalent number of frame samples per cell; 0: never seen.
  // Both or neither (empty), internal grey levels; 0 where never seen.
  Image<float> sigma;        // Standard deviation of the intensity's error.
  Image<float> residual;     // Robust rms of the frames' residuals.
  Roi roi;                   // What was read: cells of the raster, (0, 0) its upper left one.
};

struct RasterSize {
  int width = 0;
  int height = 0;
};

// All images have the same size, at least 1 x 1. Deterministic bytes. kExhausted when the disk is full; nothing is left on failure.
Status WriteSceneRaster(const std::filesystem::path& path, const Image<float>& intensity, const Image<float>& information);
// With all the bands that `scene` has; its `roi` plays no part.
Status WriteSceneRaster(const std::filesystem::path& path, const SceneRaster& scene);

// Reads the rectangle `roi` (none: all) of at most `max_pixels` cells. kCorrupt when the file is not what WriteSceneRaster writes or
// `roi` leaves it.
Result<SceneRaster> ReadSceneRaster(const std::filesystem::path& path, long long max_pixels, const std::optional<Roi>& roi = std::nullopt);

Result<RasterSize> ReadSceneRasterSize(const std::filesystem::path& path);

}  // namespace trem
