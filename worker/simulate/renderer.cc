#include "worker/simulate/renderer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

enum Purpose : std::uint64_t { kMovers = 51, kNoise, kFixedPattern, kDeadPixels };

// The detector's box seen through Gaussian optics, at distance x from the pixel's centre.
double KernelAt(double x, double sigma, double side) {
  const double scale = 1.0 / (std::numbers::sqrt2 * sigma);
  return (std::erf((x + 0.5 * side) * scale) - std::erf((x - 0.5 * side) * scale)) / (2.0 * side);
}

}  // namespace

Eigen::Vector2d Mover::At(double time_s) const {
  const double phase = std::fmod(time_s, 2.0 * turn_s);
  return start_m + velocity_m_s * (phase < turn_s ? phase : 2.0 * turn_s - phase);
}

std::vector<Mover> MakeMovers(const SimulationOptions& options, const Flight& flight) {
  std::vector<Mover> movers;
  const Eigen::Vector2d size_m = flight.seen_max_m - flight.seen_min_m;
  for (int i = 0; i < options.mover_count; ++i) {
    Rng rng({options.seed, kMovers, static_cast<std::uint64_t>(i)});
    const auto place = [&] {
      return Eigen::Vector2d(flight.seen_min_m.x() + size_m.x() * rng.Uniform(), flight.seen_min_m.y() + size_m.y() * rng.Uniform());
    };
    Mover mover;
    mover.start_m = place();
    const Eigen::Vector2d end_m = place();
    const double speed_m_s = (0.3 + rng.Uniform()) * options.gsd_m * options.frame_rate_hz;
    const double distance_m = std::max(1e-6, (end_m - mover.start_m).norm());
    mover.velocity_m_s = (end_m - mover.start_m) * (speed_m_s / distance_m);
    mover.turn_s = distance_m / speed_m_s;
    mover.half_length_m = (2.0 + 2.0 * rng.Uniform()) * options.gsd_m;
    mover.half_width_m = (1.0 + 0.7 * rng.Uniform()) * options.gsd_m;
    mover.grey = i % 2 == 0 ? 235.0 : 15.0;
    movers.push_back(mover);
  }
  return movers;
}

Renderer::Renderer(const SimulationOptions& options, const Truth& truth, const Flight& flight, std::vector<Mover> movers)
    : options_(options), truth_(truth), surface_(truth.grey), focal_px_(flight.focal_px), movers_(std::move(movers)) {
  reach_ = static_cast<int>(std::ceil((4.0 * options.psf_sigma_px + 0.5 * options.fill_factor) * kSubsamples));
  double sum = 0.0;
  for (int j = -reach_; j <= reach_; ++j) {
    weights_.push_back(KernelAt(static_cast<double>(j) / kSubsamples, options.psf_sigma_px, options.fill_factor));
    sum += weights_.back();
  }
  for (double& weight : weights_) weight /= sum;
  if (options.fixed_pattern_sigma > 0.0) {
    Rng rng({options.seed, kFixedPattern});
    fixed_pattern_ = Image<float>(options.width_px, options.height_px);
    for (float& value : fixed_pattern_.pixels()) value = static_cast<float>(options.fixed_pattern_sigma * rng.Normal());
  }
  if (options.dead_pixel_fraction > 0.0) {
    Rng rng({options.seed, kDeadPixels});
    stuck_ = Image<float>(options.width_px, options.height_px, std::numeric_limits<float>::quiet_NaN());
    for (float& value : stuck_.pixels()) {
      const bool dead = rng.Uniform() < options.dead_pixel_fraction;
      const double level = rng.Uniform();
      if (dead) value = level < 0.4 ? 0.0F : (level < 0.8 ? 255.0F : static_cast<float>(255.0 * rng.Uniform()));
    }
  }
}

Eigen::Vector2d Renderer::PixelFromFine(int x, int y) const {
  return {static_cast<double>(x - reach_) / kSubsamples, static_cast<double>(y - reach_) / kSubsamples};
}

Image<float> Renderer::Supersampled(const Exposure& exposure) const {
  Image<float> fine((options_.width_px - 1) * kSubsamples + 2 * reach_ + 1, (options_.height_px - 1) * kSubsamples + 2 * reach_ + 1);
  const CameraState& camera = exposure.camera;
  for (int y = 0; y < fine.height(); ++y) {
    for (int x = 0; x < fine.width(); ++x) {
      const Eigen::Vector2d u = PixelFromFine(x, y);
      const Eigen::Vector3d ray((u.x() - 0.5 * (options_.width_px - 1)) / focal_px_, (u.y() - 0.5 * (options_.height_px - 1)) / focal_px_,
                                1.0);
      const Eigen::Vector3d direction = camera.map_from_camera * ray;
      const Eigen::Vector2d ground = MeetGround(camera, direction);
      const Eigen::Vector2d cell = truth_.CellFromMap(ground);
      fine.at(x, y) = static_cast<float>(surface_.At(cell.x(), cell.y()));
    }
  }
  return fine;
}

void Renderer::DrawMovers(const Exposure& exposure, Image<float>* fine) const {
  for (const Mover& mover : movers_) {
    const Eigen::Vector2d centre_m = mover.At(exposure.time_s);
    const Eigen::Vector2d centre_px = PixelFromGround(exposure.camera, focal_px_, options_.width_px, options_.height_px, centre_m);
    const double half_px = 2.0 + 2.0 * mover.half_length_m / options_.gsd_m;  // Generous: an oblique view enlarges what is near.
    const auto to_fine = [&](double u) { return static_cast<int>(std::clamp(u, -1e6, 1e6) * kSubsamples) + reach_; };
    const int x0 = std::max(0, to_fine(centre_px.x() - half_px));
    const int x1 = std::min(fine->width() - 1, to_fine(centre_px.x() + half_px));
    const int y0 = std::max(0, to_fine(centre_px.y() - half_px));
    const int y1 = std::min(fine->height() - 1, to_fine(centre_px.y() + half_px));
    const Eigen::Vector2d along = mover.velocity_m_s.normalized();
    const Eigen::Vector2d across(-along.y(), along.x());
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const Eigen::Vector2d offset =
            GroundFromPixel(exposure.camera, focal_px_, options_.width_px, options_.height_px, PixelFromFine(x, y)) - centre_m;
        const double radius = std::hypot(offset.dot(along) / mover.half_length_m, offset.dot(across) / mover.half_width_m);
        // The edge is as soft as a truth cell.
        const double alpha = std::clamp(0.5 + (1.0 - radius) * mover.half_width_m / truth_.cell_m(), 0.0, 1.0);
        float& value = fine->at(x, y);
        value = static_cast<float>((1.0 - alpha) * value + alpha * mover.grey);
      }
    }
  }
}

Image<double> Renderer::Radiance(const Exposure& exposure) const {
  Image<float> fine = Supersampled(exposure);
  DrawMovers(exposure, &fine);
  const int taps = 2 * reach_ + 1;
  Image<double> rows(options_.width_px, fine.height());
  for (int y = 0; y < fine.height(); ++y) {
    for (int x = 0; x < options_.width_px; ++x) {
      const float* source = fine.row(y) + x * kSubsamples;
      double sum = 0.0;
      for (int j = 0; j < taps; ++j) sum += weights_[static_cast<std::size_t>(j)] * source[j];
      rows.at(x, y) = sum;
    }
  }
  Image<double> radiance(options_.width_px, options_.height_px, 0.0);
  for (int y = 0; y < options_.height_px; ++y) {
    double* target = radiance.row(y);
    for (int j = 0; j < taps; ++j) {
      const double weight = weights_[static_cast<std::size_t>(j)];
      const double* source = rows.row(y * kSubsamples + j);
      for (int x = 0; x < options_.width_px; ++x) target[x] += weight * source[x];
    }
  }
  return radiance;
}

double Renderer::LensFactor(std::size_t pixel) const {
  if (options_.vignetting == 0.0) return 1.0;
  const auto width = static_cast<std::size_t>(options_.width_px);
  const double half_x = 0.5 * (options_.width_px - 1), half_y = 0.5 * (options_.height_px - 1);
  const double x = static_cast<double>(pixel % width) - half_x, y = static_cast<double>(pixel / width) - half_y;
  return 1.0 - options_.vignetting * (x * x + y * y) / (half_x * half_x + half_y * half_y);
}

Image<std::uint16_t> Renderer::Frame(const Exposure& exposure) const {
  const Image<double> radiance = Radiance(exposure);
  const double counts_per_grey = options_.bit_depth == 16 ? 256.0 : 1.0;
  const double count_max = options_.bit_depth == 16 ? 65535.0 : 255.0;
  Rng noise({options_.seed, kNoise, static_cast<std::uint64_t>(exposure.index)});
  Image<std::uint16_t> frame(options_.width_px, options_.height_px);
  for (std::size_t i = 0; i < frame.pixels().size(); ++i) {
    const double level = LensFactor(i) * (exposure.gain * radiance.pixels()[i] + exposure.offset);
    const double variance = options_.noise_sigma * options_.noise_sigma + options_.shot_noise * std::max(level, 0.0);
    double grey = level + (options_.shot_noise > 0.0 ? std::sqrt(variance) : options_.noise_sigma) * noise.Normal();
    if (!fixed_pattern_.empty()) grey += fixed_pattern_.pixels()[i];
    if (!stuck_.empty() && !std::isnan(stuck_.pixels()[i])) grey = stuck_.pixels()[i];
    frame.pixels()[i] = static_cast<std::uint16_t>(std::lround(std::clamp(grey * counts_per_grey, 0.0, count_max)));
  }
  return frame;
}

}  // namespace trem
