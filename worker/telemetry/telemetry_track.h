#pragma once

#include <optional>
#include <vector>

#include "worker/telemetry/telemetry_audit.h"

namespace trem {

// Farthest apart that two samples may be for something between them to be interpolated, and farthest beyond the ends.
inline constexpr double kTrackGap_s = 5.0;
inline constexpr double kTrackBeyond_s = 0.25;

// What interpolation adds to the samples' own errors, standard deviations.
struct TrackUncertainty {
  double position_m = 0.0;
  double attitude_deg = 0.0;
};

struct TrackPose {
  CameraSample camera;
  TrackUncertainty uncertainty;
  bool interpolated = false;  // No sample lies within a millisecond.
};

// Camera poses as a function of time: positions linear between neighbouring samples, attitudes along the shortest rotation. The
// uncertainty is measured: every sample is predicted from its two neighbours. What that misses, on a curve of bend x'' sampled every h, is
// h^2 x'' / 2; between samples a gap g apart, at the fraction s of it, interpolation misses s (1 - s) g^2 x'' / 2. (White errors of the
// samples are in it too, so it is rather large than small.)
class TelemetryTrack {
 public:
  // `samples` in the order of time, without repetition.
  explicit TelemetryTrack(std::vector<CameraSample> samples);

  // Nothing in gaps longer than kTrackGap_s and farther than kTrackBeyond_s from the ends.
  std::optional<TrackPose> At(double time_s) const;
  bool empty() const { return samples_.empty(); }
  const std::vector<CameraSample>& samples() const { return samples_; }
  // Median interval of the samples; 0: fewer than two.
  double interval_s() const { return interval_s_; }

 private:
  void MeasureUncertainty();

  std::vector<CameraSample> samples_;
  double interval_s_ = 0.0;
  TrackUncertainty miss_;  // Of a sample predicted from its neighbours, per (span / interval)^2.
};

// The same for image corners (no uncertainty).
std::optional<std::array<GeoPoint, 4>> CornersAt(const std::vector<CornerSample>& samples, double time_s);

}  // namespace trem
