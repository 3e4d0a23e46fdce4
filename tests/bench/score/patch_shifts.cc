#include "tests/bench/score/patch_shifts.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "mosaic/base/check.h"

namespace trem::score {
namespace {

constexpr double kCorrelationMin = 0.6;

cv::Mat View(const Image<float>& image, const cv::Rect& rect) {
  return cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0)))(rect);
}

bool AllFinite(const Image<float>& image, const cv::Rect& rect) {
  for (int y = rect.y; y < rect.y + rect.height; ++y) {
    for (int x = rect.x; x < rect.x + rect.width; ++x) {
      if (!std::isfinite(image.at(x, y))) return false;
    }
  }
  return true;
}

// Root mean square gradient in the direction in which it is weakest: an edge along one direction only cannot fix a shift.
double Texture(const Image<float>& image, const cv::Rect& rect) {
  double xx = 0.0, xy = 0.0, yy = 0.0;
  int count = 0;
  for (int y = std::max(1, rect.y); y < std::min(image.height() - 1, rect.y + rect.height); ++y) {
    for (int x = std::max(1, rect.x); x < std::min(image.width() - 1, rect.x + rect.width); ++x, ++count) {
      const double gx = 0.5 * (image.at(x + 1, y) - image.at(x - 1, y));
      const double gy = 0.5 * (image.at(x, y + 1) - image.at(x, y - 1));
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  if (count == 0) return 0.0;
  const double weakest = 0.5 * (xx + yy - std::hypot(xx - yy, 2.0 * xy));
  return std::sqrt(std::max(0.0, weakest) / count);
}

// Refines `shift` by Gauss-Newton on sum (gain truth(p - shift) + offset - mosaic(p))^2 over the patch.
// Returns false, with `shift` left alone, when that leads away.
bool Refine(const Image<float>& mosaic, const SplineSurface& truth, const cv::Rect& rect, int margin, Eigen::Vector2d* shift) {
  Eigen::Vector2d refined = *shift;
  Image<float> warped(rect.width + 2, rect.height + 2);
  for (int iteration = 0; iteration < 8; ++iteration) {
    for (int y = 0; y < warped.height(); ++y) {
      for (int x = 0; x < warped.width(); ++x) {
        warped.at(x, y) = static_cast<float>(truth.At(std::clamp(rect.x + x - 1 + margin - refined.x(), 0.0, truth.width() - 1.0),
                                                      std::clamp(rect.y + y - 1 + margin - refined.y(), 0.0, truth.height() - 1.0)));
      }
    }
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    for (int y = 0; y < rect.height; ++y) {
      for (int x = 0; x < rect.width; ++x) {
        const double gx = 0.5 * (warped.at(x + 2, y + 1) - warped.at(x, y + 1));
        const double gy = 0.5 * (warped.at(x + 1, y + 2) - warped.at(x + 1, y));
        // Linear in (gain, offset, -gain dx, -gain dy).
        const Eigen::Vector4d row(warped.at(x + 1, y + 1), 1.0, gx, gy);
        normal += row * row.transpose();
        right += row * mosaic.at(rect.x + x, rect.y + y);
      }
    }
    const Eigen::Vector4d solution = normal.ldlt().solve(right);
    if (!solution.allFinite() || std::abs(solution[0]) < 1e-6) return false;
    const Eigen::Vector2d step(-solution[2] / solution[0], -solution[3] / solution[0]);
    refined += step;
    // Out of reach of a linear model: the correlation's peak is the better answer.
    if ((refined - *shift).norm() > 2.0) return false;
    if (step.norm() < 1e-3) break;
  }
  *shift = refined;
  return true;
}

// Whether a patch is one grey level but for rounding; its correlation with anything is undefined (and 1 for OpenCV).
bool Flat(const cv::Mat& patch) {
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(patch, mean, deviation);
  return deviation[0] <= 1e-5 * std::abs(mean[0]);
}

PatchShift MatchPatch(const Image<float>& mosaic, const Image<float>& truth, const SplineSurface& surface, const cv::Rect& rect,
                      const Eigen::Vector2i& start, const PatchOptions& options) {
  const int radius = options.radius_px;
  PatchShift patch;
  patch.centre_px = {rect.x + 0.5 * (rect.width - 1), rect.y + 0.5 * (rect.height - 1)};
  if (Flat(View(mosaic, rect))) return patch;
  const cv::Rect window(rect.x + options.margin_px - start.x() - radius, rect.y + options.margin_px - start.y() - radius,
                        rect.width + 2 * radius, rect.height + 2 * radius);
  cv::Mat correlation;
  cv::matchTemplate(View(truth, window), View(mosaic, rect), correlation, cv::TM_CCOEFF_NORMED);
  double best = 0.0;
  cv::Point place;
  cv::minMaxLoc(correlation, nullptr, &best, nullptr, &place);
  const Eigen::Vector2i off_start(radius - place.x, radius - place.y);
  patch.shift_px = (start + off_start).cast<double>();
  patch.matched = best >= kCorrelationMin && off_start.cwiseAbs().maxCoeff() < radius &&
                  Refine(mosaic, surface, rect, options.margin_px, &patch.shift_px);
  return patch;
}

}  // namespace

std::vector<PatchShift> MeasurePatchShifts(const Image<float>& mosaic, const Image<float>& truth, const Eigen::Vector2d& start_px,
                                           const PatchOptions& options) {
  TREM_CHECK(mosaic.width() + 2 * options.margin_px == truth.width() && mosaic.height() + 2 * options.margin_px == truth.height());
  const SplineSurface surface(truth);
  const Eigen::Vector2i start = start_px.array().round().cast<int>();
  TREM_CHECK(start.cwiseAbs().maxCoeff() + options.radius_px <= options.margin_px);
  const int stride = std::max(1, options.patch_px / 2);
  std::vector<PatchShift> shifts;
  for (int y = 0; y + options.patch_px <= mosaic.height(); y += stride) {
    for (int x = 0; x + options.patch_px <= mosaic.width(); x += stride) {
      const cv::Rect rect(x, y, options.patch_px, options.patch_px);
      const cv::Rect in_truth(x + options.margin_px - start.x(), y + options.margin_px - start.y(), options.patch_px, options.patch_px);
      if (!AllFinite(mosaic, rect) || Texture(truth, in_truth) < options.texture) continue;
      shifts.push_back(MatchPatch(mosaic, truth, surface, rect, start, options));
    }
  }
  return shifts;
}

std::optional<Eigen::Vector2d> MedianShift(const std::vector<PatchShift>& shifts, int least) {
  std::vector<double> x;
  std::vector<double> y;
  for (const PatchShift& shift : shifts) {
    if (!shift.matched) continue;
    x.push_back(shift.shift_px.x());
    y.push_back(shift.shift_px.y());
  }
  if (static_cast<int>(x.size()) < least) return std::nullopt;
  return Eigen::Vector2d(Quantile(std::move(x), 0.5), Quantile(std::move(y), 0.5));
}

double Quantile(std::vector<double> values, double q) {
  TREM_CHECK(!values.empty() && q >= 0.0 && q <= 1.0);
  std::sort(values.begin(), values.end());
  const double place = q * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(place);
  const std::size_t high = std::min(low + 1, values.size() - 1);
  return values[low] + (place - static_cast<double>(low)) * (values[high] - values[low]);
}

}  // namespace trem::score
