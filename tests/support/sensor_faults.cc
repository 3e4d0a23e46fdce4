#include "tests/support/sensor_faults.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "mosaic/base/rng.h"

namespace trem::testing {

Image<float> AddFixedPattern(double sigma, std::uint64_t seed, RenderedSequence* sequence) {
  Rng rng({seed, 21});
  Image<float> pattern(sequence->roi.width(), sequence->roi.height());
  for (float& bias : pattern.pixels()) bias = static_cast<float>(sigma * rng.Normal());
  for (FrameInput& frame : sequence->frames) {
    for (std::size_t i = 0; i < pattern.pixels().size(); ++i) frame.pixels.pixels()[i] += pattern.pixels()[i];
  }
  return pattern;
}

std::vector<int> AddBadPixels(double part, std::uint64_t seed, RenderedSequence* sequence) {
  Rng rng({seed, 22});
  const int area = static_cast<int>(sequence->roi.area());
  std::set<int> places;
  while (static_cast<double>(places.size()) < part * area) places.insert(std::min(area - 1, static_cast<int>(rng.Uniform() * area)));
  int kind = 0;
  for (const int place : places) {
    const float stuck = static_cast<float>(60.0 + 100.0 * rng.Uniform());
    for (FrameInput& frame : sequence->frames) {
      float& pixel = frame.pixels.pixels()[static_cast<std::size_t>(place)];
      if (kind % 4 == 0) pixel = 0.0F;
      if (kind % 4 == 1) pixel = 255.0F;
      if (kind % 4 == 2) pixel = stuck;
      if (kind % 4 == 3 && rng.Uniform() < 0.5) pixel = 0.0F;
    }
    ++kind;
  }
  return {places.begin(), places.end()};
}

void AddMover(const Mover& mover, RenderedSequence* sequence) {
  // How much of pixel i the mover covers along one axis.
  const auto cover = [&mover](int i, double centre) { return std::clamp(0.5 * mover.side_px + 0.5 - std::abs(i - centre), 0.0, 1.0); };
  for (int t = mover.begin; t < std::min<int>(mover.end, static_cast<int>(sequence->frames.size())); ++t) {
    Image<float>& frame = sequence->frames[static_cast<std::size_t>(t)].pixels;
    const double x = mover.x + mover.speed_x * (t - mover.begin);
    const double y = mover.y + mover.speed_y * (t - mover.begin);
    for (int v = 0; v < frame.height(); ++v) {
      for (int u = 0; u < frame.width(); ++u) {
        const float part = static_cast<float>(cover(u, x) * cover(v, y));
        frame.at(u, v) += part * (static_cast<float>(mover.grey) - frame.at(u, v));
      }
    }
  }
}

void JumpBrightness(double gain, double offset, int frame, RenderedSequence* sequence) {
  for (std::size_t t = static_cast<std::size_t>(frame); t < sequence->frames.size(); ++t) {
    for (float& pixel : sequence->frames[t].pixels.pixels()) pixel = static_cast<float>(gain * pixel + offset);
  }
}

void Saturate(double level, bool weighted, RenderedSequence* sequence) {
  for (FrameInput& frame : sequence->frames) {
    if (weighted) frame.weights = Image<float>(frame.pixels.width(), frame.pixels.height(), 1.0F);
    for (std::size_t i = 0; i < frame.pixels.pixels().size(); ++i) {
      float& pixel = frame.pixels.pixels()[i];
      if (pixel < level) continue;
      pixel = static_cast<float>(level);
      if (weighted) frame.weights.pixels()[i] = 0.0F;
    }
  }
}

}  // namespace trem::testing
