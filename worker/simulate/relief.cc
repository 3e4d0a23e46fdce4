#include "worker/simulate/relief.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <utility>

#include "mosaic/base/rng.h"
#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

constexpr std::uint64_t kReliefPurpose = 71;
constexpr int kNodeCells = 16;  // Truth cells a node.
constexpr int kWaves = 4;
constexpr long long kNodesMax = 1LL << 24;

}  // namespace

std::shared_ptr<const GriddedGround> MakeRelief(const SimulationOptions& options, const MosaicGrid& grid) {
  if (options.relief_m <= 0.0) return nullptr;
  const double step_m = kNodeCells * grid.gsd;
  const int columns = 2 * (grid.width / kNodeCells + 1);
  const int rows = 2 * (grid.height / kNodeCells + 1);
  const Eigen::Vector2d origin(grid.origin_x - 0.25 * columns * step_m, grid.origin_y + 0.25 * rows * step_m);
  const double side_m = grid.gsd * std::max(grid.width, grid.height);
  Image<float> heights(columns, rows, 0.0F);
  Rng rng({options.seed, kReliefPurpose});
  for (int wave = 0; wave < kWaves; ++wave) {
    const double bearing = 2.0 * std::numbers::pi * rng.Uniform();
    const double phase = 2.0 * std::numbers::pi * rng.Uniform();
    const double number = 2.0 * std::numbers::pi / (side_m * (0.6 + 0.6 * rng.Uniform()));
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < columns; ++x) {
        const double along_m = step_m * (x * std::cos(bearing) + y * std::sin(bearing));
        heights.at(x, y) += static_cast<float>(std::sin(phase + number * along_m));
      }
    }
  }
  // Peak to peak over the truth itself.
  float low = std::numeric_limits<float>::infinity(), high = -low;
  for (int y = rows / 4; y <= rows / 4 + rows / 2; ++y) {
    for (int x = columns / 4; x <= columns / 4 + columns / 2; ++x) {
      low = std::min(low, heights.at(x, y));
      high = std::max(high, heights.at(x, y));
    }
  }
  const auto half = static_cast<float>(0.5 * options.relief_m);
  for (float& z : heights.pixels()) z = std::clamp((z - low) / (high - low) * 2.0F * half - half, -half, half);
  return std::make_shared<GriddedGround>(origin, Eigen::Vector2d(step_m, -step_m), std::move(heights));
}

Status WriteRelief(const GriddedGround& relief, double ground_elevation_m, const std::string& crs_wkt, const std::filesystem::path& path) {
  MosaicGrid grid;
  grid.crs_wkt = crs_wkt;
  grid.origin_x = relief.origin().x();
  grid.origin_y = relief.origin().y();
  grid.gsd = relief.step().x();
  grid.width = relief.elevations_m().width();
  grid.height = relief.elevations_m().height();
  Image<float> elevations = relief.elevations_m();
  for (float& z : elevations.pixels()) z += static_cast<float>(ground_elevation_m);
  return WriteFloatRaster(path, {{{"elevation, metres", std::move(elevations)}}, grid, std::nullopt, {}});
}

Result<std::shared_ptr<const GriddedGround>> ReadRelief(const std::filesystem::path& path, double ground_elevation_m) {
  InitialiseGdal();
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, OpenTiff(path, "relief"));
  GeoTransform geotransform;
  if (dataset->GetGeoTransform(geotransform.data()) != CE_None) return InvalidInput("relief '" + path.string() + "' is not georeferenced");
  TREM_ASSIGN_OR_RETURN(const MosaicGrid grid,
                        GridFromGeoTransform(geotransform, dataset->GetRasterXSize(), dataset->GetRasterYSize()));
  TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> bands, ReadFloatBands(path, {0}, std::nullopt, kNodesMax));
  for (float& z : bands.front().pixels()) z -= static_cast<float>(ground_elevation_m);
  return std::shared_ptr<const GriddedGround>(std::make_shared<GriddedGround>(
      Eigen::Vector2d(grid.origin_x, grid.origin_y), Eigen::Vector2d(grid.gsd, -grid.gsd), std::move(bands.front())));
}

}  // namespace trem
