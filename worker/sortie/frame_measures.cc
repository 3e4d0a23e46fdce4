#include "worker/sortie/frame_measures.h"

#include <algorithm>
#include <utility>

#include "worker/sortie/frame_motion.h"

namespace trem {
namespace {

constexpr double kBlankSpan = 2.0;  // Grey levels of an 8-bit source.

void MeasurePixels(Image<float> pixels, const FrameMeasuring& by, FrameMeasures* measures) {
  const std::optional<double> saturation = by.saturation_level.has_value() ? by.saturation_level
                                           : measures->grey_max > 0.0      ? std::optional<double>(measures->grey_max)
                                                                           : std::nullopt;
  if (saturation.has_value()) {
    const auto level = static_cast<float>(*saturation);
    measures->saturated_count =
        std::count_if(pixels.pixels().begin(), pixels.pixels().end(), [level](float value) { return value >= level; });
  }
  if (by.filler != nullptr) by.filler->Fill(&pixels);
  measures->line_means = BorderFinder::MeansOf(pixels);
  measures->sample = QuantileSampler::PixelsOf(pixels);
  const Roi middle = {pixels.width() / 10, pixels.height() / 10, pixels.width() - pixels.width() / 10,
                      pixels.height() - pixels.height() / 10};
  measures->noise_sigma = EstimateNoiseSigma(pixels, middle, by.mask != nullptr ? &by.mask->usable : nullptr);
  measures->reduced = ReduceFrame(pixels);
}

}  // namespace

FrameMeasures MeasureFrame(Result<GreyImage> frame, const FrameMeasuring& by) {
  FrameMeasures measures;
  measures.read = frame.status();
  if (!frame.ok()) return measures;
  measures.width_px = frame->pixels.width();
  measures.height_px = frame->pixels.height();
  measures.grey_max = frame->grey_max;
  if (!measures.SizeIs(by)) return measures;
  measures.fingerprint = PixelFingerprint(frame->pixels);
  measures.middle = MiddleRange(frame->pixels);
  measures.blank = measures.middle.high - measures.middle.low <= (measures.grey_max == 255.0 ? kBlankSpan : 0.0);
  if (!measures.blank) MeasurePixels(std::move(frame->pixels), by, &measures);
  return measures;
}

}  // namespace trem
