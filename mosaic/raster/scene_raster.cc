#include "mosaic/raster/scene_raster.h"

#include <string>

#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

Result<FloatRasterInfo> Checked(const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(FloatRasterInfo info, InspectFloatRaster(path));
  if (info.band_count != 2 && info.band_count != 4) {
    return Corrupt("scene raster " + path.string() + " has " + std::to_string(info.band_count) +
                   " bands; expected 2 (intensity, information) or 4 (and sigma, residual)");
  }
  return info;
}

}  // namespace

Status WriteSceneRaster(const std::filesystem::path& path, const Image<float>& intensity, const Image<float>& information) {
  return WriteSceneRaster(path, SceneRaster{intensity, information, {}, {}, {}});
}

Status WriteSceneRaster(const std::filesystem::path& path, const SceneRaster& scene) {
  FloatRaster raster;
  raster.bands.push_back({"intensity", scene.intensity});
  raster.bands.push_back({"information", scene.information});
  if (!scene.sigma.empty()) {
    raster.bands.push_back({"sigma", scene.sigma});
    raster.bands.push_back({"residual", scene.residual});
  }
  return WriteFloatRaster(path, raster).WithPrefix("scene raster");
}

Result<SceneRaster> ReadSceneRaster(const std::filesystem::path& path, long long max_pixels, const std::optional<Roi>& roi) {
  TREM_ASSIGN_OR_RETURN(const FloatRasterInfo info, Checked(path));
  const std::vector<int> wanted = info.band_count == 4 ? std::vector<int>{0, 1, 2, 3} : std::vector<int>{0, 1};
  TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> bands, ReadFloatBands(path, wanted, roi, max_pixels));
  SceneRaster scene;
  scene.roi = roi.value_or(Roi{0, 0, info.width, info.height});
  scene.intensity = std::move(bands[0]);
  scene.information = std::move(bands[1]);
  if (bands.size() < 4) return scene;
  scene.sigma = std::move(bands[2]);
  scene.residual = std::move(bands[3]);
  return scene;
}

Result<RasterSize> ReadSceneRasterSize(const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const FloatRasterInfo info, Checked(path));
  return RasterSize{info.width, info.height};
}

}  // namespace trem
