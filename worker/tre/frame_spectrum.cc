#include "worker/tre/frame_spectrum.h"

#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace trem {
namespace {

constexpr int kSide = FrameSpectrum::kSide;
constexpr int kMissingMax = kSide * kSide / 50;
// Bad pixels come alone or in small clusters: what is farther from a measurement is a mask's.
constexpr int kFillRounds = 3;

// The tile at (x0, y0); an empty matrix when too much of it is missing.
cv::Mat CopyTile(const Image<float>& pixels, int x0, int y0) {
  cv::Mat tile(kSide, kSide, CV_32F);
  int missing = 0;
  for (int y = 0; y < kSide; ++y) {
    const float* row = pixels.row(y0 + y) + x0;
    for (int x = 0; x < kSide; ++x) {
      tile.at<float>(y, x) = row[x];
      missing += std::isfinite(row[x]) ? 0 : 1;
    }
  }
  if (missing > kMissingMax) return {};
  for (int round = 0; missing > 0 && round < kFillRounds; ++round) {
    const cv::Mat before = tile.clone();
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        if (std::isfinite(before.at<float>(y, x))) continue;
        double sum = 0.0;
        int count = 0;
        for (int v = std::max(y - 1, 0); v <= std::min(y + 1, kSide - 1); ++v) {
          for (int u = std::max(x - 1, 0); u <= std::min(x + 1, kSide - 1); ++u) {
            const float pixel = before.at<float>(v, u);
            if (!std::isfinite(pixel)) continue;
            sum += pixel;
            ++count;
          }
        }
        if (count == 0) continue;
        tile.at<float>(y, x) = static_cast<float>(sum / count);
        --missing;
      }
    }
  }
  return missing > 0 ? cv::Mat() : tile;
}

}  // namespace

void FrameSpectrum::Add(const Image<float>& pixels) {
  cv::Mat window;
  cv::createHanningWindow(window, cv::Size(kSide, kSide), CV_32F);
  const double window_sum = cv::sum(window)[0];
  const double window_power = cv::norm(window, cv::NORM_L2SQR);
  for (int y0 = 0; y0 + kSide <= pixels.height(); y0 += kSide / 2) {
    for (int x0 = 0; x0 + kSide <= pixels.width(); x0 += kSide / 2) {
      cv::Mat tile = CopyTile(pixels, x0, y0);
      if (tile.empty()) continue;
      tile -= cv::Scalar(cv::sum(tile.mul(window))[0] / window_sum);
      cv::Mat spectrum;
      cv::dft(tile.mul(window), spectrum, cv::DFT_COMPLEX_OUTPUT);
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          const auto& value = spectrum.at<cv::Vec2f>(y, x);
          power_sum_(y, x) += (static_cast<double>(value[0]) * value[0] + static_cast<double>(value[1]) * value[1]) / window_power;
        }
      }
      ++tile_count_;
    }
  }
}

std::vector<FrameSpectrum::Bin> FrameSpectrum::Bins(double frequency_min) const {
  std::vector<Bin> bins;
  if (tile_count_ == 0) return bins;
  for (int y = 1; y < kSide / 2; ++y) {
    for (int x = 1; x < kSide; ++x) {
      Bin bin;
      bin.fx = static_cast<double>(x < kSide / 2 ? x : x - kSide) / kSide;
      bin.fy = static_cast<double>(y) / kSide;
      bin.power = power_sum_(y, x) / tile_count_;
      if (std::hypot(bin.fx, bin.fy) >= frequency_min && bin.power > 0.0) bins.push_back(bin);
    }
  }
  return bins;
}

}  // namespace trem
