#include "worker/simulate/control_points.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "mosaic/base/rng.h"
#include "mosaic/raster/crs.h"
#include "worker/simulate/records.h"

namespace trem {
namespace {

constexpr std::uint64_t kControlPurpose = 72;
constexpr int kFramesApart = 6;
constexpr double kBorderPx = 4.0;
// Places in the image that the points take in turn, as parts of its width and height.
constexpr std::array<std::array<double, 2>, 4> kPlaces = {{{0.25, 0.3}, {0.75, 0.7}, {0.7, 0.25}, {0.3, 0.75}}};

}  // namespace

Result<std::string> ControlPointsCsv(const SimulationOptions& options, const Truth& truth, const Flight& flight) {
  TREM_ASSIGN_OR_RETURN(const UtmFrame map, UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg));
  std::string text = "name,longitude_deg,latitude_deg,elevation_m,frame,x_px,y_px\n";
  const auto frame_count = static_cast<int>(flight.exposures.size());
  for (int point = 0; point < options.control_count; ++point) {
    const int first = (2 * point + 1) * frame_count / (2 * options.control_count);
    const auto& place = kPlaces[static_cast<std::size_t>(point) % kPlaces.size()];
    const Exposure& reference = flight.exposures[static_cast<std::size_t>(first)];
    const Eigen::Vector2d ground = GroundFromPixel(reference.camera, flight.focal_px, options.width_px, options.height_px,
                                                   {place[0] * (options.width_px - 1), place[1] * (options.height_px - 1)});
    const double z = truth.relief ? truth.relief->ElevationAt(ground).value_or(0.0) : 0.0;
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d latitude_longitude, map.Inverse(ground));
    for (int step = -1; step <= 1; ++step) {
      const int index = std::clamp(first + step * kFramesApart, 0, frame_count - 1);
      const Exposure& exposure = flight.exposures[static_cast<std::size_t>(index)];
      if (exposure.dropped) continue;
      Rng rng({options.seed, kControlPurpose, static_cast<std::uint64_t>(point), static_cast<std::uint64_t>(index)});
      const Eigen::Vector2d noise(rng.Normal(), rng.Normal());
      const Eigen::Vector2d u = PixelFromGround(exposure.camera, flight.focal_px, options.width_px, options.height_px, ground) +
                                options.control_noise_px * noise;
      if (u.x() < kBorderPx || u.y() < kBorderPx || u.x() > options.width_px - kBorderPx || u.y() > options.height_px - kBorderPx) continue;
      text += fmt::format("P{},{:.10f},{:.10f},{:.4f},{},{:.4f},{:.4f}\n", point + 1, latitude_longitude.y(), latitude_longitude.x(),
                          options.ground_elevation_m + z, FrameName(exposure.index), u.x(), u.y());
    }
  }
  return text;
}

}  // namespace trem
