#include "worker/tre/sensor_corrections.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace trem {
namespace {

constexpr double kStepMin = 0.3;  // Sensor pixels that the view has to move for a bad pixel to show.
constexpr int kDecideEvery = 4;
constexpr int kFramesMin = 8;
constexpr std::size_t kListedMax = 10;

}  // namespace

SensorCorrections::SensorCorrections(const Roi& roi, Correction mode)
    : roi_(roi), mode_(mode), bias_(roi.width(), roi.height(), mode), bad_(roi.width(), roi.height()) {}

void SensorCorrections::Correct(FrameInput* frame) const {
  if (bias_.active()) {
    const std::span<const float> bias = bias_.bias().pixels();
    const std::span<float> pixels = frame->pixels.pixels();
    for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] -= bias[i];
  }
  if (bad_.count() == 0) return;
  if (frame->weights.empty()) frame->weights = Image<float>(roi_.width(), roi_.height(), 1.0F);
  for (const int index : bad_.list()) frame->weights.pixels()[static_cast<std::size_t>(index)] = 0.0F;
  for (const int index : bad_.list()) {
    const int x = index % roi_.width();
    const int y = index / roi_.width();
    float sum = 0.0F;
    float count = 0.0F;
    for (int j = std::max(y - 1, 0); j <= std::min(y + 1, roi_.height() - 1); ++j) {
      for (int i = std::max(x - 1, 0); i <= std::min(x + 1, roi_.width() - 1); ++i) {
        if (!(frame->weights.at(i, j) > 0.0F) || std::isnan(frame->pixels.at(i, j))) continue;
        sum += frame->pixels.at(i, j);
        count += 1.0F;
      }
    }
    if (count > 0.0F) frame->pixels.at(x, y) = sum / count;
  }
}

void SensorCorrections::Learn(const FrameInput& frame, const FrameResidual& residual, const View& view, double noise_sigma) {
  if (mode_ == Correction::kOff) return;
  const Eigen::Vector2d middle(0.5 * (roi_.x0 + roi_.x1 - 1), 0.5 * (roi_.y0 + roi_.y1 - 1));
  // Scene cells to sensor pixels: the plane's grid is that of its first frame.
  const double scale = std::sqrt(std::abs(view.scene_from_sensor.linear.determinant()));
  const double step = bias_.Learn(residual, (view.scene_from_sensor * middle) / scale, noise_sigma);
  if (step < kStepMin) return;
  bad_.Learn(frame.pixels, residual, noise_sigma, bias_.sigma());
  if (++learned_ % kDecideEvery == 0 && bias_.separable()) bad_.Decide(noise_sigma, bias_.sigma());
}

bool SensorCorrections::WorthRevisiting() {
  if (revisited_ || learned_ < kFramesMin || (!bias_.active() && bad_.count() == 0)) return false;
  revisited_ = true;
  bias_.Revisit();
  return true;
}

std::string SensorCorrections::BiasNote() const {
  if (!bias_.active()) return {};
  char text[120];
  std::snprintf(text, sizeof text, "a fixed pattern of the detector, sigma %.1f grey levels (internal), was estimated and removed",
                bias_.sigma());
  return text;
}

std::string SensorCorrections::BadPixelNote() const {
  if (bad_.count() == 0) return {};
  std::string text = std::to_string(bad_.count()) + (bad_.count() == 1 ? " bad pixel was" : " bad pixels were") + " found and not used:";
  for (std::size_t i = 0; i < std::min(bad_.list().size(), kListedMax); ++i) {
    const int index = bad_.list()[i];
    text += " (" + std::to_string(roi_.x0 + index % roi_.width()) + ", " + std::to_string(roi_.y0 + index / roi_.width()) + ")";
  }
  if (bad_.list().size() > kListedMax) text += " and others";
  return text;
}

}  // namespace trem
