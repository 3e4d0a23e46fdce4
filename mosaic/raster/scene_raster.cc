#include "mosaic/raster/scene_raster.h"

#include <string>

#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

Result<RasterSize> CheckedSize(const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const FloatRasterInfo info, InspectFloatRaster(path));
  if (info.band_count != 2) {
    return Corrupt("scene raster " + path.string() + " has " + std::to_string(info.band_count) +
                   " bands; expected 2 (intensity, information)");
  }
  return RasterSize{info.width, info.height};
}

}  // namespace

Status WriteSceneRaster(const std::filesystem::path& path, const Image<float>& intensity, const Image<float>& information) {
  FloatRaster raster;
  raster.bands.push_back({"intensity", intensity});
  raster.bands.push_back({"information", information});
  return WriteFloatRaster(path, raster).WithPrefix("scene raster");
}

Result<SceneRaster> ReadSceneRaster(const std::filesystem::path& path, long long max_pixels, const std::optional<Roi>& roi) {
  TREM_ASSIGN_OR_RETURN(const RasterSize size, CheckedSize(path));
  TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> bands, ReadFloatBands(path, {0, 1}, roi, max_pixels));
  SceneRaster scene;
  scene.roi = roi.value_or(Roi{0, 0, size.width, size.height});
  scene.intensity = std::move(bands[0]);
  scene.information = std::move(bands[1]);
  return scene;
}

Result<RasterSize> ReadSceneRasterSize(const std::filesystem::path& path) { return CheckedSize(path); }

}  // namespace trem
