#include "tests/bench/score/fidelity.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace trem::score {
namespace {

cv::Mat View(const Image<float>& image) { return cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0))); }

// One gain and offset that bring `image` closest to `truth` over the finite pixels.
void FitToTruth(const Image<float>& truth, Image<float>* image) {
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
    const double x = image->pixels()[i];
    const double y = truth.pixels()[i];
    if (!std::isfinite(x) || !std::isfinite(y)) continue;
    n += 1, sx += x, sy += y, sxx += x * x, sxy += x * y;
  }
  const double spread = n * sxx - sx * sx;
  const double gain = spread > 0.0 ? (n * sxy - sx * sy) / spread : 0.0;
  const double offset = n > 0.0 ? (sy - gain * sx) / n : 0.0;
  for (float& value : image->pixels()) value = static_cast<float>(gain * value + offset);
}

double Psnr(const Image<float>& truth, const Image<float>& image) {
  double squares = 0.0;
  double count = 0.0;
  for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
    const double error = static_cast<double>(image.pixels()[i]) - truth.pixels()[i];
    if (!std::isfinite(error)) continue;
    squares += error * error;
    count += 1.0;
  }
  // A perfect mosaic would be infinite, which JSON cannot say.
  return count > 0.0 ? 10.0 * std::log10(255.0 * 255.0 / std::max(squares / count, 1e-9)) : 0.0;
}

// Mean structural similarity over the pixels whose window holds compared pixels only.
double Ssim(const Image<float>& truth, const Image<float>& image) {
  cv::Mat a = View(truth).clone();
  cv::Mat b = View(image).clone();
  cv::Mat valid(a.rows, a.cols, CV_8U);
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      const bool finite = std::isfinite(a.at<float>(y, x)) && std::isfinite(b.at<float>(y, x));
      valid.at<std::uint8_t>(y, x) = finite ? 255 : 0;
      if (!finite) a.at<float>(y, x) = b.at<float>(y, x) = 0.0F;
    }
  }
  cv::erode(valid, valid, cv::Mat::ones(11, 11, CV_8U), {-1, -1}, 1, cv::BORDER_CONSTANT, cv::Scalar(0));
  const auto blur = [](const cv::Mat& m) {
    cv::Mat wide, out;
    m.convertTo(wide, CV_64F);
    cv::GaussianBlur(wide, out, {11, 11}, 1.5);
    return out;
  };
  cv::Mat a64, b64;
  a.convertTo(a64, CV_64F);
  b.convertTo(b64, CV_64F);
  const cv::Mat ma = blur(a64), mb = blur(b64), aa = blur(a64.mul(a64)), bb = blur(b64.mul(b64)), ab = blur(a64.mul(b64));
  constexpr double kC1 = 0.01 * 255 * 0.01 * 255;
  constexpr double kC2 = 0.03 * 255 * 0.03 * 255;
  double sum = 0.0;
  double count = 0.0;
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      if (valid.at<std::uint8_t>(y, x) == 0) continue;
      const double u = ma.at<double>(y, x), v = mb.at<double>(y, x);
      const double su = aa.at<double>(y, x) - u * u, sv = bb.at<double>(y, x) - v * v, suv = ab.at<double>(y, x) - u * v;
      sum += (2 * u * v + kC1) * (2 * suv + kC2) / ((u * u + v * v + kC1) * (su + sv + kC2));
      count += 1.0;
    }
  }
  return count > 0.0 ? sum / count : 0.0;
}

}  // namespace

Evenness MeasureEvenness(const Image<float>& truth, const Image<float>& image, int block_px) {
  const int columns = image.width() / block_px, rows = image.height() / block_px;
  Image<float> errors(std::max(1, columns), std::max(1, rows), std::numeric_limits<float>::quiet_NaN());
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      double sum = 0.0;
      for (int y = row * block_px; y < (row + 1) * block_px; ++y) {
        for (int x = column * block_px; x < (column + 1) * block_px; ++x) sum += static_cast<double>(image.at(x, y)) - truth.at(x, y);
      }
      errors.at(column, row) = static_cast<float>(sum / (block_px * block_px));  // NaN where a pixel is not compared.
    }
  }
  Evenness evenness;
  double squares = 0.0, count = 0.0;
  std::vector<double> steps;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const float error = errors.at(column, row);
      if (!std::isfinite(error)) continue;
      squares += error * error;
      count += 1.0;
      if (column + 1 < columns && std::isfinite(errors.at(column + 1, row))) steps.push_back(std::abs(errors.at(column + 1, row) - error));
      if (row + 1 < rows && std::isfinite(errors.at(column, row + 1))) steps.push_back(std::abs(errors.at(column, row + 1) - error));
    }
  }
  if (count > 0.0) evenness.level_rms = std::sqrt(squares / count);
  if (steps.empty()) return evenness;
  const auto at = steps.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(steps.size() - 1));
  std::nth_element(steps.begin(), at, steps.end());
  evenness.step_p95 = *at;
  return evenness;
}

Fidelity FitAndCompare(const Image<float>& truth, Image<float>* image) {
  FitToTruth(truth, image);
  return {Psnr(truth, *image), Ssim(truth, *image)};
}

}  // namespace trem::score
