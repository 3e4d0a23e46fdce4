#include "worker/tre/frame_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace trem {
namespace {

constexpr float kGreyMax = 1e6F;
constexpr double kUsablePartMin = 0.25;
// The least spread of an image: below it, every pixel is the same.
constexpr double kSpreadMin = 1e-3;
// Optics blur: neighbouring pixels of an image with contrast have at least this correlation.
constexpr double kNeighbourCorrelationMin = 0.1;
constexpr double kContrastSigmas = 3.0;
constexpr double kRepeatSigmas = 0.25;

// Continues NaNs of a row; false when it holds nothing else.
bool ContinueRow(float* row, int width) {
  int before = -1;
  for (int x = 0; x < width; ++x) {
    if (std::isnan(row[x])) continue;
    for (int hole = before + 1; hole < x; ++hole) row[hole] = before >= 0 && hole - before <= x - hole ? row[before] : row[x];
    before = x;
  }
  if (before < 0) return false;
  std::fill(row + before + 1, row + width, row[before]);
  return true;
}

// Of every second row: enough for a verdict on the whole.
struct Statistics {
  long long pixels = 0;
  long long usable = 0;
  long long pairs = 0;  // Of usable horizontal neighbours.
  double sum = 0.0;
  double squares = 0.0;
  double differences = 0.0;  // Squared, of the pairs.
  float low = std::numeric_limits<float>::max();
  float high = std::numeric_limits<float>::lowest();
};

Statistics StatisticsOf(const FrameInput& frame) {
  Statistics s;
  const Image<float>& pixels = frame.pixels;
  for (int y = 0; y < pixels.height(); y += 2) {
    const float* row = pixels.row(y);
    const float* weights = frame.weights.empty() ? nullptr : frame.weights.row(y);
    bool before = false;
    for (int x = 0; x < pixels.width(); ++x) {
      const bool usable = !std::isnan(row[x]) && (weights == nullptr || weights[x] > 0.0F);
      ++s.pixels;
      if (usable) {
        ++s.usable;
        s.sum += row[x];
        s.squares += static_cast<double>(row[x]) * row[x];
        s.low = std::min(s.low, row[x]);
        s.high = std::max(s.high, row[x]);
        if (before) {
          ++s.pairs;
          s.differences += static_cast<double>(row[x] - row[x - 1]) * (row[x] - row[x - 1]);
        }
      }
      before = usable;
    }
  }
  return s;
}

}  // namespace

void DropImpossible(Image<float>* pixels) {
  for (float& pixel : pixels->pixels()) {
    if (!(std::abs(pixel) <= kGreyMax)) pixel = std::numeric_limits<float>::quiet_NaN();
  }
}

std::string WhyUnusable(const FrameInput& frame, double noise_sigma) {
  const Statistics s = StatisticsOf(frame);
  char text[160];
  if (static_cast<double>(s.usable) < kUsablePartMin * static_cast<double>(s.pixels)) {
    std::snprintf(text, sizeof text, "has %.0f %% usable pixels in the ROI; at least %.0f %% needed",
                  100.0 * static_cast<double>(s.usable) / static_cast<double>(std::max<long long>(s.pixels, 1)), 100.0 * kUsablePartMin);
    return text;
  }
  if (s.high - s.low < kSpreadMin) {
    std::snprintf(text, sizeof text, "is constant in the ROI: every usable pixel is %.3g", static_cast<double>(s.low));
    return text;
  }
  const double mean = s.sum / static_cast<double>(s.usable);
  const double variance = s.squares / static_cast<double>(s.usable) - mean * mean;
  if (s.pairs > s.usable / 2 && variance > std::pow(kContrastSigmas * noise_sigma, 2)) {
    const double correlation = 1.0 - 0.5 * s.differences / static_cast<double>(s.pairs) / variance;
    if (correlation < kNeighbourCorrelationMin) {
      std::snprintf(text, sizeof text, "is noise: correlation %.2f of neighbouring pixels at a contrast of %.1f grey levels", correlation,
                    std::sqrt(variance));
      return text;
    }
  }
  return {};
}

bool ContinueHoles(Image<float>* pixels) {
  const auto nan = [](float value) { return std::isnan(value); };
  if (std::none_of(pixels->pixels().begin(), pixels->pixels().end(), nan)) return false;
  const std::size_t width = static_cast<std::size_t>(pixels->width());
  int before = -1;
  for (int y = 0; y < pixels->height(); ++y) {
    if (!ContinueRow(pixels->row(y), pixels->width())) continue;
    for (int hole = before + 1; hole < y; ++hole)
      std::copy_n(pixels->row(before >= 0 && hole - before <= y - hole ? before : y), width, pixels->row(hole));
    before = y;
  }
  for (int hole = before + 1; before >= 0 && hole < pixels->height(); ++hole) std::copy_n(pixels->row(before), width, pixels->row(hole));
  return before >= 0;
}

bool Repeats(const Image<float>& now, const Image<float>& before, double noise_sigma) {
  if (now.empty() || now.width() != before.width() || now.height() != before.height()) return false;
  double sum = 0.0;
  long long count = 0;
  for (int y = 0; y < now.height(); ++y) {
    const float* a = now.row(y);
    const float* b = before.row(y);
    float row_sum = 0.0F;
    int row_count = 0;
    for (int x = 0; x < now.width(); ++x) {
      const float difference = std::abs(a[x] - b[x]);
      const bool usable = difference <= kGreyMax;  // Not when either is NaN.
      row_sum += usable ? difference : 0.0F;
      row_count += usable ? 1 : 0;
    }
    sum += row_sum;
    count += row_count;
    // Frames that differ, differ everywhere: most are told apart by their first rows.
    if (y == 15 && sum > 4.0 * kRepeatSigmas * noise_sigma * static_cast<double>(count)) return false;
  }
  return count > 0 && sum < kRepeatSigmas * noise_sigma * static_cast<double>(count);
}

}  // namespace trem
