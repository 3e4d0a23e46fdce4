#include "mosaic/composite/warp.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "mosaic/geometry/footprint.h"

namespace trem {
namespace {

constexpr double kKeysA = -0.5;
constexpr int kTapsMax = 4 * static_cast<int>(kWarpScaleMax) + 2;

double Keys(double t) {
  t = std::abs(t);
  if (t < 1.0) return ((kKeysA + 2.0) * t - (kKeysA + 3.0)) * t * t + 1.0;
  if (t < 2.0) return ((kKeysA * t - 5.0 * kKeysA) * t + 8.0 * kKeysA) * t - 4.0 * kKeysA;
  return 0.0;
}

// Stretch of the kernel for a step of `step` cells a pixel: 1 up to 1.25, the step from 1.75 on, linear in between so that sharpness
// changes nowhere abruptly.
// Takes the squared step: the root is needed only where the kernel is stretched.
double KernelScale(double step_squared) {
  if (step_squared <= 1.25 * 1.25) return 1.0;
  const double step = std::sqrt(step_squared);
  if (step < 1.75) return 1.0 + (step - 1.25) * 1.5;
  return std::min(step, kWarpScaleMax);
}

double SquaredNorm(double a, double b) { return a * a + b * b; }

// Square of the smaller singular value of [[a, b], [c, d]].
double LeastStretchSquared(double a, double b, double c, double d) {
  const double sum = SquaredNorm(a, b) + SquaredNorm(c, d), determinant = a * d - b * c;
  return 0.5 * (sum - std::sqrt(std::max(sum * sum - 4.0 * determinant * determinant, 0.0)));
}

struct Taps {
  int first = 0;  // Cell index of weight[0], relative to the source's images.
  int count = 0;
  std::array<double, kTapsMax> weight;
};

// Normalised weights around `s` (relative to the image); trims weights of exactly 0, so that a pixel on a cell's centre needs no others.
void ComputeTaps(double s, double scale, Taps* taps) {
  if (scale == 1.0) {
    // The usual case, in closed form: the four weights sum to 1 by construction.
    const double base = std::floor(s), f = s - base;
    if (f == 0.0) {
      taps->first = static_cast<int>(base);
      taps->count = 1;
      taps->weight[0] = 1.0;
      return;
    }
    const double g = 1.0 - f;
    taps->first = static_cast<int>(base) - 1;
    taps->count = 4;
    taps->weight[0] = kKeysA * f * g * g;
    taps->weight[1] = ((kKeysA + 2.0) * f - (kKeysA + 3.0)) * f * f + 1.0;
    taps->weight[2] = ((kKeysA + 2.0) * g - (kKeysA + 3.0)) * g * g + 1.0;
    taps->weight[3] = kKeysA * g * f * f;
    return;
  }
  const double radius = 2.0 * scale;
  int first = static_cast<int>(std::ceil(s - radius));
  int last = static_cast<int>(std::floor(s + radius));
  while (first < last && Keys((first - s) / scale) == 0.0) ++first;
  while (last > first && Keys((last - s) / scale) == 0.0) --last;
  taps->first = first;
  taps->count = last - first + 1;
  double sum = 0.0;
  for (int i = 0; i < taps->count; ++i) {
    taps->weight[static_cast<std::size_t>(i)] = Keys((first + i - s) / scale);
    sum += taps->weight[static_cast<std::size_t>(i)];
  }
  for (int i = 0; i < taps->count; ++i) taps->weight[static_cast<std::size_t>(i)] /= sum;
}

struct Sample {
  double intensity = 0.0;
  double information = 0.0;
};

// False when a cell under the kernel is outside the images or unseen.
bool Convolve(const WarpSource& source, const Taps& tx, const Taps& ty, bool surely_seen, Sample* sample) {
  const int width = source.intensity.width();
  const int height = source.intensity.height();
  if (tx.first < 0 || ty.first < 0 || tx.first + tx.count > width || ty.first + ty.count > height) return false;
  double intensity = 0.0, information = 0.0, information_weight = 0.0;
  for (int j = 0; j < ty.count; ++j) {
    const float* intensity_row = source.intensity.row(ty.first + j) + tx.first;
    const float* information_row = source.information.row(ty.first + j) + tx.first;
    const double wy = ty.weight[static_cast<std::size_t>(j)];
    const double wy_positive = std::max(wy, 0.0);
    double row_sum = 0.0, row_information = 0.0, row_weight = 0.0;
    for (int i = 0; i < tx.count; ++i) {
      const double wx = tx.weight[static_cast<std::size_t>(i)];
      if (!surely_seen && !(information_row[i] > 0.0f) && wx != 0.0 && wy != 0.0) return false;
      row_sum += wx * intensity_row[i];
      // Information must stay positive: only the kernel's positive lobe counts.
      const double wx_positive = std::max(wx, 0.0);
      row_information += wx_positive * information_row[i];
      row_weight += wx_positive;
    }
    intensity += wy * row_sum;
    information += wy_positive * row_information;
    information_weight += wy_positive * row_weight;
  }
  sample->intensity = intensity;
  sample->information = information / information_weight;
  return true;
}

}  // namespace

int WarpMarginCells(double distance_cells) {
  // Twice the support: the shortcut "no unseen cell near" looks as far as the kernel's diagonal.
  return static_cast<int>(std::ceil(std::max(distance_cells, 2.0 * kWarpSupportCells))) + kWarpSupportCells;
}

Result<WarpSource> PrepareWarp(SceneRaster raster, const Roi& raster_in_scene) {
  WarpSource source;
  source.roi_in_scene = {raster.roi.x0 + raster_in_scene.x0, raster.roi.y0 + raster_in_scene.y0, raster.roi.x1 + raster_in_scene.x0,
                         raster.roi.y1 + raster_in_scene.y0};
  if (!raster_in_scene.Contains(source.roi_in_scene)) {
    return Corrupt("scene cells " + ToString(source.roi_in_scene) + " lie outside of the scene's raster " + ToString(raster_in_scene));
  }
  const int width = raster.intensity.width();
  const int height = raster.intensity.height();
  if (width != raster.roi.width() || height != raster.roi.height() || raster.information.width() != width ||
      raster.information.height() != height) {
    return Corrupt("the scene's bands differ in size");
  }
  // One ring of padding, unseen where the scene's raster ends and seen where only the part that was read does.
  cv::Mat1b seen(height + 2, width + 2, static_cast<unsigned char>(255));
  const Roi& part = source.roi_in_scene;
  if (part.x0 == raster_in_scene.x0) seen.col(0).setTo(0);
  if (part.x1 == raster_in_scene.x1) seen.col(width + 1).setTo(0);
  if (part.y0 == raster_in_scene.y0) seen.row(0).setTo(0);
  if (part.y1 == raster_in_scene.y1) seen.row(height + 1).setTo(0);
  for (int y = 0; y < height; ++y) {
    float* intensity = raster.intensity.row(y);
    float* information = raster.information.row(y);
    for (int x = 0; x < width; ++x) {
      if (information[x] > 0.0f && std::isfinite(information[x]) && std::isfinite(intensity[x])) continue;
      information[x] = 0.0f;
      intensity[x] = 0.0f;
      seen(y + 1, x + 1) = 0;
    }
  }
  source.border_distance = Image<float>(width, height);
  cv::Mat1f distance;
  cv::distanceTransform(seen, distance, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  for (int y = 0; y < height; ++y) std::copy_n(distance.ptr<float>(y + 1) + 1, width, source.border_distance.row(y));
  source.intensity = std::move(raster.intensity);
  source.information = std::move(raster.information);
  return source;
}

WarpedScene WarpScene(const WarpSource& source, const WarpMap& map, const Roi& roi_in_mosaic) {
  WarpedScene warped;
  warped.roi_in_mosaic = roi_in_mosaic;
  const int width = roi_in_mosaic.width();
  const int height = roi_in_mosaic.height();
  warped.intensity = Image<float>(width, height, std::numeric_limits<float>::quiet_NaN());
  warped.information = Image<float>(width, height, 0.0f);
  warped.border_distance = Image<float>(width, height, 0.0f);
  warped.detail = Image<float>(width, height, 0.0f);
  const Eigen::Matrix3d& m = map.scene_from_mosaic.matrix;
  const int source_width = source.intensity.width();
  const int source_height = source.intensity.height();
  Taps tx, ty;
  for (int row = 0; row < height; ++row) {
    const double y = roi_in_mosaic.y0 + row;
    for (int column = 0; column < width; ++column) {
      const double x = roi_in_mosaic.x0 + column;
      const double depth = m(2, 0) * x + m(2, 1) * y + m(2, 2);
      if (!IsVisibleDepth(depth)) continue;
      const double level_u = (m(0, 0) * x + m(0, 1) * y + m(0, 2)) / depth;
      const double level_v = (m(1, 0) * x + m(1, 1) * y + m(1, 2)) / depth;
      double u = level_u, v = level_v;
      if (!map.shifts.empty()) {
        const Eigen::Vector2d shift = map.shifts.At({level_u, level_v});
        u += shift.x();
        v += shift.y();
      }
      // In cells of the images. The subtraction of whole cells is exact, so the fraction does not depend on the part that was read.
      const double nearest_u = std::floor(u + 0.5), nearest_v = std::floor(v + 0.5);
      const double cell_x = nearest_u - source.roi_in_scene.x0, cell_y = nearest_v - source.roi_in_scene.y0;
      if (!(cell_x >= 0.0 && cell_y >= 0.0 && cell_x < source_width && cell_y < source_height)) continue;
      const float distance = source.border_distance.at(static_cast<int>(cell_x), static_cast<int>(cell_y));
      if (!(distance > 0.0f)) continue;
      // What hills stretch is left out here: a hundredth or two of a step decide no kernel.
      const double u_x = (m(0, 0) - level_u * m(2, 0)) / depth, u_y = (m(0, 1) - level_u * m(2, 1)) / depth;
      const double v_x = (m(1, 0) - level_v * m(2, 0)) / depth, v_y = (m(1, 1) - level_v * m(2, 1)) / depth;
      const double scale_u = KernelScale(SquaredNorm(u_x, u_y));
      const double scale_v = KernelScale(SquaredNorm(v_x, v_y));
      ComputeTaps(u - nearest_u, scale_u, &tx);
      ComputeTaps(v - nearest_v, scale_v, &ty);
      tx.first += static_cast<int>(cell_x);
      ty.first += static_cast<int>(cell_y);
      const bool surely_seen = distance > 2.0 * (scale_u + scale_v) + 1.5;
      Sample sample;
      if (!Convolve(source, tx, ty, surely_seen, &sample)) continue;
      if (!map.shade.empty()) sample.intensity *= map.shade.At({u, v});
      warped.intensity.at(column, row) = static_cast<float>(sample.intensity);
      warped.information.at(column, row) = static_cast<float>(sample.information);
      warped.border_distance.at(column, row) = distance;
      warped.detail.at(column, row) = static_cast<float>(LeastStretchSquared(u_x, u_y, v_x, v_y));
    }
  }
  return warped;
}

}  // namespace trem
