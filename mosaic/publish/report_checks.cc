// The report's verdict: bounds that a person would apply, applied.
#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "mosaic/publish/report.h"

namespace trem {
namespace {

using Verdict = ReportCheck::Verdict;

// `value` judged by two bounds of which the first is the stricter.
Verdict AtLeast(double value, double good, double fair) {
  return value >= good ? Verdict::kGood : value >= fair ? Verdict::kLook : Verdict::kBad;
}
Verdict AtMost(double value, double good, double fair) {
  return value <= good ? Verdict::kGood : value <= fair ? Verdict::kLook : Verdict::kBad;
}

ReportCheck Frames(const ReportData& data) {
  const double part = data.frame_count > 0 ? static_cast<double>(data.registered_count) / data.frame_count : 0.0;
  return {"Frames registered", fmt::format("{:.1f} % of {}", 100.0 * part, data.frame_count), AtLeast(part, 0.95, 0.8),
          "Lost frames leave thin or missing ground. Good from 95 %, poor below 80 %."};
}

ReportCheck Ties(const ReportData& data) {
  return {"How well frames and scenes agree", fmt::format("{:.3f} sensor px (rms)", data.tie_rms_px), AtMost(data.tie_rms_px, 0.35, 1.0),
          "What is left between them after the alignment: distortion inside the mosaic. Good up to 0.35 px, poor above 1 px."};
}

ReportCheck Pieces(const ReportData& data) {
  return {"Connected pieces", fmt::format("{}", data.piece_count), data.piece_count <= 1 ? Verdict::kGood : Verdict::kLook,
          data.georeferenced ? "Pieces that nothing but telemetry places can be off against each other by its error."
                             : "Without telemetry, how pieces lie to each other is arbitrary."};
}

ReportCheck Position(const ReportData& data) {
  if (!data.georeferenced) {
    return {"Place on Earth", "none", Verdict::kLook, "No telemetry: scale, north and position are arbitrary, in sensor pixels."};
  }
  const bool known = std::isfinite(data.median_position_sigma);
  return {"Standard error of position", known ? fmt::format("{:.2f} m (median)", data.median_position_sigma) : "not known",
          known ? Verdict::kGood : Verdict::kLook,
          "By the telemetry's stated accuracy; if that is wrong, so is this. It is no measure of distortion."};
}

ReportCheck Overlap(const ReportData& data) {
  return {"Scenes over a pixel", fmt::format("{:.0f} (median)", data.median_scenes), AtLeast(data.median_scenes, 3.0, 1.0),
          "From three on a median can outvote what moved or went wrong in one. Two can still disagree, which the spread shows. One is "
          "checked by no "
          "other: it is made of many frames that agreed with it, and its standard error of position holds, but a mover, or a scene that "
          "lies wrong, "
          "would not be noticed. So one is a reason to look, not to reject."};
}

ReportCheck Spread(const ReportData& data) {
  const double part = data.grey_range > 0.0 ? data.median_nmad / data.grey_range : std::numeric_limits<double>::quiet_NaN();
  if (!std::isfinite(part)) {
    return {"Spread between scenes", "not known", Verdict::kLook, "No pixel was seen by two scenes."};
  }
  return {"Spread between scenes", fmt::format("{:.2f} grey levels, {:.1f} % of the range", data.median_nmad, 100.0 * part),
          AtMost(part, 0.02, 0.05), "Independent scenes should show the same ground. Good up to 2 % of the grey range, poor above 5 %."};
}

ReportCheck Holes(const ReportData& data) {
  return {"Parts that failed", fmt::format("{}", data.hole_count), data.hole_count == 0 ? Verdict::kGood : Verdict::kBad,
          "Windows that could not be computed, or a mosaic that nothing covers; the warnings name them."};
}

}  // namespace

std::vector<ReportCheck> JudgeMosaic(const ReportData& data) {
  return {Frames(data), Ties(data), Overlap(data), Spread(data), Position(data), Pieces(data), Holes(data)};
}

}  // namespace trem
