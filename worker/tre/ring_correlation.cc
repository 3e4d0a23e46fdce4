#include "worker/tre/ring_correlation.h"

#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>

#include "mosaic/base/check.h"

namespace trem {
namespace {

constexpr int kSide = 64;
constexpr int kRings = kSide / 2;
constexpr double kThreshold = 1.0 / 7.0;
// Of the ground's slow changes the window leaves little, and in every picture the same.
constexpr int kFirstRing = 4;

struct Ring {
  double cross = 0.0;
  double power_a = 0.0;
  double power_b = 0.0;

  double Correlation() const { return power_a > 0.0 && power_b > 0.0 ? cross / std::sqrt(power_a * power_b) : 0.0; }
};

// The four-term window of Blackman and Harris: its side lobes are at 1e-9 of the power. Scenes have that much less power at their finest
// frequencies than at the coarse ones, whose leakage would agree whatever the noise (F. J. Harris, Proc. IEEE 66, 1978).
cv::Mat Window() {
  cv::Mat row(1, kSide, CV_64F);
  for (int x = 0; x < kSide; ++x) {
    const double t = 2.0 * std::numbers::pi * (x + 0.5) / kSide;
    row.at<double>(x) = 0.35875 - 0.48829 * std::cos(t) + 0.14128 * std::cos(2.0 * t) - 0.01168 * std::cos(3.0 * t);
  }
  return row.t() * row;
}

// The windowed spectrum of the Laplacian (so that what leaks is less still) of the tile at (x0, y0), which is at least one cell away from
// the border; empty when it is not seen as a whole.
cv::Mat TileSpectrum(const Image<float>& image, int x0, int y0, const cv::Mat& window) {
  cv::Mat tile(kSide, kSide, CV_64F);
  for (int y = 0; y < kSide; ++y) {
    const float* above = image.row(y0 + y - 1) + x0;
    const float* row = image.row(y0 + y) + x0;
    const float* below = image.row(y0 + y + 1) + x0;
    for (int x = 0; x < kSide; ++x) {
      const double laplacian = static_cast<double>(above[x]) + below[x] + row[x - 1] + row[x + 1] - 4.0 * row[x];
      if (!std::isfinite(laplacian)) return {};
      tile.at<double>(y, x) = laplacian;
    }
  }
  cv::Mat spectrum;
  cv::dft(tile.mul(window), spectrum, cv::DFT_COMPLEX_OUTPUT);
  return spectrum;
}

void Add(const cv::Mat& a, const cv::Mat& b, std::array<Ring, kRings>* rings) {
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const int fx = x < kSide / 2 ? x : x - kSide;
      const int fy = y < kSide / 2 ? y : y - kSide;
      const auto index = static_cast<std::size_t>(std::lround(std::hypot(fx, fy)));
      if (index >= kRings) continue;
      const auto& u = a.at<cv::Vec2d>(y, x);
      const auto& v = b.at<cv::Vec2d>(y, x);
      Ring& ring = (*rings)[index];
      ring.cross += u[0] * v[0] + u[1] * v[1];
      ring.power_a += u[0] * u[0] + u[1] * u[1];
      ring.power_b += v[0] * v[0] + v[1] * v[1];
    }
  }
}

}  // namespace

double AgreementLimit(const Image<float>& a, const Image<float>& b) {
  TREM_CHECK(a.width() == b.width() && a.height() == b.height());
  const cv::Mat window = Window();
  std::array<Ring, kRings> rings;
  for (int y0 = 1; y0 + kSide < a.height(); y0 += kSide / 2) {
    for (int x0 = 1; x0 + kSide < a.width(); x0 += kSide / 2) {
      const cv::Mat of_a = TileSpectrum(a, x0, y0, window);
      if (of_a.empty()) continue;
      const cv::Mat of_b = TileSpectrum(b, x0, y0, window);
      if (!of_b.empty()) Add(of_a, of_b, &rings);
    }
  }
  if (rings[kFirstRing].power_a <= 0.0) return 0.0;
  double before = 1.0;
  for (int k = kFirstRing; k < kRings; ++k) {
    const double correlation = rings[static_cast<std::size_t>(k)].Correlation();
    if (correlation < kThreshold) return (k - 1 + (before - kThreshold) / (before - correlation)) / kSide;
    before = correlation;
  }
  return 0.5;
}

}  // namespace trem
