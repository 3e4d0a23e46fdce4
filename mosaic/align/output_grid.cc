#include "mosaic/align/output_grid.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "mosaic/base/check.h"

namespace trem::align {

double SensorGsd(std::span<const Homography> world_from_sensor, int width_px, int height_px) {
  TREM_CHECK(!world_from_sensor.empty());
  const Eigen::Vector2d centre(0.5 * (width_px - 1), 0.5 * (height_px - 1));
  std::vector<double> gsd;
  for (const Homography& map : world_from_sensor) {
    if (!(map.Depth(centre) > 0.0)) continue;
    const double value = std::sqrt(std::abs(map.LinearisedAt(centre).linear.determinant()));
    if (std::isfinite(value) && value > 0.0) gsd.push_back(value);
  }
  if (gsd.empty()) return 1.0;
  const auto middle = gsd.begin() + static_cast<std::ptrdiff_t>(gsd.size() / 2);
  std::nth_element(gsd.begin(), middle, gsd.end());
  return *middle;
}

namespace {

Status CheckMeets(const std::array<double, 4>& box, const char* what, const Eigen::Vector2d& low, const Eigen::Vector2d& high) {
  const auto& [x_min, y_min, x_max, y_max] = box;
  if (low.x() <= x_max && high.x() >= x_min && low.y() <= y_max && high.y() >= y_min) return {};
  std::ostringstream message;
  message.precision(12);
  message << what << " " << x_min << "," << y_min << "," << x_max << "," << y_max << " does not meet what was seen, " << low.x() << ","
          << low.y() << "," << high.x() << "," << high.y() << "; expected x_min,y_min,x_max,y_max in coordinates of the mosaic's CRS";
  return InvalidInput(message.str());
}

}  // namespace

Result<MosaicGrid> ChooseGrid(std::span<const SceneFootprint> footprints, double sensor_gsd, int ratio, const GridOptions& options) {
  TREM_CHECK(!footprints.empty());
  MosaicGrid grid;
  grid.crs_wkt = options.crs_wkt;
  grid.tile_size = options.tile_size;
  grid.gsd = options.gsd > 0.0 ? options.gsd : sensor_gsd / ratio;
  Eigen::Vector2d low = footprints.front().corners[0];
  Eigen::Vector2d high = low;
  for (const SceneFootprint& footprint : footprints) {
    for (const Eigen::Vector2d& corner : footprint.corners) {
      low = low.cwiseMin(corner);
      high = high.cwiseMax(corner);
    }
  }
  if (options.bounds) TREM_RETURN_IF_ERROR(CheckMeets(*options.bounds, "mosaic.bounds", low, high));
  if (options.clip) TREM_RETURN_IF_ERROR(CheckMeets(*options.clip, "mosaic.cutline_path: the rectangle", low, high));
  if (options.bounds) {
    const auto& [x_min, y_min, x_max, y_max] = *options.bounds;
    // Half a pixel in: pixels are areas, and the grid counts their centres.
    low = {x_min + 0.5 * grid.gsd, y_min + 0.5 * grid.gsd};
    high = Eigen::Vector2d(x_max - 0.5 * grid.gsd, y_max - 0.5 * grid.gsd).cwiseMax(low);
  } else if (options.clip) {
    const auto& [x_min, y_min, x_max, y_max] = *options.clip;
    low = low.cwiseMax(Eigen::Vector2d(x_min, y_min));
    high = high.cwiseMin(Eigen::Vector2d(x_max, y_max));
  }
  const double column_first = std::floor(low.x() / grid.gsd);
  const double column_last = std::ceil(high.x() / grid.gsd);
  const double row_first = std::ceil(high.y() / grid.gsd);  // Rows run down, y up.
  const double row_last = std::floor(low.y() / grid.gsd);
  const double width = column_last - column_first + 1.0;
  const double height = row_first - row_last + 1.0;
  if (!(width <= options.side_max) || !(height <= options.side_max)) {
    std::ostringstream message;
    message << "the mosaic would be " << width << " x " << height << " pixels at a ground sample distance of " << grid.gsd
            << "; expected at most " << options.side_max << " a side. Set mosaic.gsd to at least "
            << grid.gsd * std::max(width, height) / options.side_max
            << ", or split the sortie with source.first_frame and source.max_frames";
    return InvalidInput(message.str());
  }
  grid.origin_x = column_first * grid.gsd;
  grid.origin_y = row_first * grid.gsd;
  grid.width = static_cast<int>(width);
  grid.height = static_cast<int>(height);
  return grid;
}

}  // namespace trem::align
