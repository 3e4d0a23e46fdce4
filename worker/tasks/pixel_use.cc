#include "worker/tasks/pixel_use.h"

#include <cmath>
#include <limits>

#include "worker/sortie/pixel_mask.h"
#include "worker/sortie/vignetting.h"
#include "worker/tasks/sensor_of.h"

namespace trem {
namespace {

constexpr float kSaturatedWeight = 0.05F;

}  // namespace

Result<PixelUse> PixelUse::Of(const v1::Sensor& sensor, const v1::SortieManifest& manifest) {
  PixelUse use;
  const v1::SensorManifest& found = manifest.sensor();
  if (found.unusable_runs_size() > 0) {
    TREM_ASSIGN_OR_RETURN(use.usable_, UsableFromRuns({found.unusable_runs().data(), static_cast<std::size_t>(found.unusable_runs_size())},
                                                      static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())));
  }
  use.brightening_ = BrighteningOf(found, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px()));
  use.grey_offset_ = manifest.grey_offset();
  use.grey_scale_ = manifest.grey_scale();
  use.black_ = static_cast<float>(-manifest.grey_offset() / manifest.grey_scale());
  if (found.has_saturation_level()) {
    use.saturation_level_ = static_cast<float>((found.saturation_level() - manifest.grey_offset()) / manifest.grey_scale());
  }
  if (sensor.shot_noise() > 0.0) use.noise_ = NoiseModelOf(sensor, manifest);
  return use;
}

void PixelUse::Take(const Image<float>& whole, const Roi& roi, FrameInput* frame) const {
  frame->pixels = Image<float>(roi.width(), roi.height());
  const float offset = static_cast<float>(grey_offset_);
  const float factor = static_cast<float>(1.0 / grey_scale_);
  for (int y = 0; y < roi.height(); ++y) {
    const float* from = whole.row(roi.y0 + y) + roi.x0;
    const std::uint8_t* usable = usable_.empty() ? nullptr : usable_.row(roi.y0 + y) + roi.x0;
    float* to = frame->pixels.row(y);
    for (int x = 0; x < roi.width(); ++x) {
      to[x] = usable != nullptr && usable[x] == 0 ? std::numeric_limits<float>::quiet_NaN() : (from[x] - offset) * factor;
    }
  }
  Weigh(frame);
  if (!brightening_.empty()) UndoVignetting(roi, frame);
}

void PixelUse::UndoVignetting(const Roi& roi, FrameInput* frame) const {
  if (frame->weights.empty()) frame->weights = Image<float>(roi.width(), roi.height(), 1.0F);
  for (int y = 0; y < roi.height(); ++y) {
    const float* factor = brightening_.row(roi.y0 + y) + roi.x0;
    float* pixel = frame->pixels.row(y);
    float* weight = frame->weights.row(y);
    for (int x = 0; x < roi.width(); ++x) {
      pixel[x] = black_ + (pixel[x] - black_) * factor[x];
      weight[x] /= factor[x] * factor[x];
    }
  }
}

void PixelUse::Weigh(FrameInput* frame) const {
  if (noise_.has_value()) {
    Image<float> above_black = frame->pixels;
    for (float& pixel : above_black.pixels()) pixel -= black_;
    frame->weights = NoiseWeights(above_black, *noise_);
  }
  if (!saturation_level_.has_value()) return;
  for (std::size_t i = 0; i < frame->pixels.pixels().size(); ++i) {
    if (!(frame->pixels.pixels()[i] >= *saturation_level_)) continue;
    if (frame->weights.empty()) frame->weights = Image<float>(frame->pixels.width(), frame->pixels.height(), 1.0F);
    frame->weights.pixels()[i] *= kSaturatedWeight;
  }
}

double PixelUse::UsablePart(const Roi& roi) const {
  if (usable_.empty()) return 1.0;
  long long count = 0;
  for (int y = roi.y0; y < roi.y1; ++y) {
    for (int x = roi.x0; x < roi.x1; ++x) count += usable_.at(x, y);
  }
  return static_cast<double>(count) / static_cast<double>(roi.area());
}

}  // namespace trem
