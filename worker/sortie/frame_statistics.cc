#include "worker/sortie/frame_statistics.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>

namespace trem {
namespace {

constexpr int kBlock_px = 16;
constexpr double kNoiseQuantile = 0.15;
// What the quantile of pure noise comes out as, relative to sigma (measured on normal noise; see frame_statistics_test).
constexpr double kNoiseQuantileBias = 0.924;

constexpr std::size_t kSampleMax = std::size_t{1} << 20;
constexpr std::size_t kSamplePerFrame = 4096;

double BlockSigma(const Image<float>& frame, int x0, int y0) {
  double sum = 0.0;
  for (int y = y0; y < y0 + kBlock_px; ++y) {
    const float* a = frame.row(y - 1);
    const float* b = frame.row(y);
    const float* c = frame.row(y + 1);
    for (int x = x0; x < x0 + kBlock_px; ++x) {
      const float laplacian = a[x - 1] - 2 * a[x] + a[x + 1] - 2 * b[x - 1] + 4 * b[x] - 2 * b[x + 1] + c[x - 1] - 2 * c[x] + c[x + 1];
      sum += std::abs(laplacian);
    }
  }
  return std::sqrt(M_PI / 2.0) / 6.0 * sum / (kBlock_px * kBlock_px);
}

bool IsUsable(const Image<std::uint8_t>& usable, int x0, int y0) {
  for (int y = y0 - 1; y <= y0 + kBlock_px; ++y) {
    const std::uint8_t* row = usable.row(y);
    if (std::find(row + x0 - 1, row + x0 + kBlock_px + 1, 0) != row + x0 + kBlock_px + 1) return false;
  }
  return true;
}

}  // namespace

double EstimateNoiseSigma(const Image<float>& frame, const Roi& roi, const Image<std::uint8_t>* usable) {
  std::vector<double> sigmas;
  for (int y = roi.y0 + 1; y + kBlock_px < roi.y1; y += kBlock_px) {
    for (int x = roi.x0 + 1; x + kBlock_px < roi.x1; x += kBlock_px) {
      if (usable == nullptr || IsUsable(*usable, x, y)) sigmas.push_back(BlockSigma(frame, x, y));
    }
  }
  if (sigmas.empty()) return 0.0;
  const auto rank = sigmas.begin() + static_cast<std::ptrdiff_t>(kNoiseQuantile * static_cast<double>(sigmas.size() - 1));
  std::nth_element(sigmas.begin(), rank, sigmas.end());
  return *rank / kNoiseQuantileBias;
}

std::uint64_t PixelFingerprint(const Image<float>& frame) {
  constexpr std::uint64_t kPrime = 0x100000001b3ULL;
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  const auto mix = [&hash](std::uint32_t word) { hash = (hash ^ word) * kPrime; };
  mix(static_cast<std::uint32_t>(frame.width()));
  mix(static_cast<std::uint32_t>(frame.height()));
  for (const float value : frame.pixels()) mix(std::bit_cast<std::uint32_t>(value));
  return hash;
}

ValueRange MiddleRange(const Image<float>& frame) {
  const int x0 = frame.width() / 5;
  const int x1 = std::max(x0 + 1, frame.width() - x0);
  const int y0 = frame.height() / 5;
  const int y1 = std::max(y0 + 1, frame.height() - y0);
  ValueRange range{frame.at(x0, y0), frame.at(x0, y0)};
  for (int y = y0; y < y1; ++y) {
    const auto [low, high] = std::minmax_element(frame.row(y) + x0, frame.row(y) + x1);
    range.low = std::min(range.low, *low);
    range.high = std::max(range.high, *high);
  }
  return range;
}

std::vector<float> QuantileSampler::PixelsOf(const Image<float>& frame) {
  // An odd stride that shares no factor with most widths visits all columns.
  const std::size_t stride = std::max<std::size_t>(1, frame.pixels().size() / kSamplePerFrame) | 1U;
  std::vector<float> pixels;
  for (std::size_t i = 0; i < frame.pixels().size(); i += stride) pixels.push_back(frame.pixels()[i]);
  return pixels;
}

void QuantileSampler::Add(const std::vector<float>& pixels) {
  if (frame_count_++ % frame_stride_ != 0) return;
  values_.insert(values_.end(), pixels.begin(), pixels.end());
  if (values_.size() <= kSampleMax) return;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < values_.size(); i += 2) values_[kept++] = values_[i];
  values_.resize(kept);
  frame_stride_ *= 2;
}

double QuantileSampler::Quantile(double p, double skipped) const {
  if (values_.empty()) return 0.0;
  std::vector<float> values = values_;
  const double position = (skipped + p * (1.0 - skipped)) * static_cast<double>(values.size() - 1);
  const auto rank = values.begin() + static_cast<std::ptrdiff_t>(std::clamp(position, 0.0, static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), rank, values.end());
  return *rank;
}

GreyScaling ChooseGreyScaling(double grey_max, const QuantileSampler& sampler, double border_part) {
  if (grey_max == 255.0) return {};
  constexpr double kLow = 10.0;
  constexpr double kHigh = 245.0;
  const double low = sampler.Quantile(0.005, border_part);
  const double high = sampler.Quantile(0.995, border_part);
  if (!(high > low)) return {low - 128.0, 1.0};
  GreyScaling scaling;
  scaling.scale = (high - low) / (kHigh - kLow);
  scaling.offset = low - kLow * scaling.scale;
  return scaling;
}

}  // namespace trem
