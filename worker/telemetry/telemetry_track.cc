#include "worker/telemetry/telemetry_track.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "mosaic/base/check.h"
#include "worker/telemetry/audit_geometry.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kMetresPerDegree = 111320.0;
constexpr double kSame_s = 1e-3;

double Blend(double a, double b, double t) { return a + (b - a) * t; }
double BlendAngle(double a_deg, double b_deg, double t) { return a_deg + std::remainder(b_deg - a_deg, 360.0) * t; }
std::optional<double> Blend(const std::optional<double>& a, const std::optional<double>& b, double t) {
  if (!a.has_value() || !b.has_value()) return t < 0.5 ? a : b;
  return Blend(*a, *b, t);
}

Eigen::Quaterniond Rotation(const CameraSample& sample) {
  return Eigen::Quaterniond(WorldFromCamera(sample.yaw_deg * kRad, sample.pitch_deg * kRad, sample.roll_deg * kRad));
}

CameraSample Between(const CameraSample& a, const CameraSample& b, double t) {
  CameraSample c;
  c.time_s = Blend(a.time_s, b.time_s, t);
  c.latitude_deg = Blend(a.latitude_deg, b.latitude_deg, t);
  c.longitude_deg = std::remainder(BlendAngle(a.longitude_deg, b.longitude_deg, t), 360.0);
  c.altitude_m = Blend(a.altitude_m, b.altitude_m, t);
  const Eigen::Vector3d angles = AnglesOfRotation(Rotation(a).slerp(t, Rotation(b)).toRotationMatrix());
  c.yaw_deg = angles[0] / kRad;
  c.pitch_deg = angles[1] / kRad;
  c.roll_deg = angles[2] / kRad;
  c.hfov_deg = Blend(a.hfov_deg, b.hfov_deg, t);
  c.vfov_deg = Blend(a.vfov_deg, b.vfov_deg, t);
  return c;
}

// The pair of samples around `time_s` and the fraction between them; nothing when it lies in a gap or beyond the ends. At the ends the
// nearest pair is prolonged.
struct Bracket {
  std::size_t a = 0;
  std::size_t b = 0;
  double t = 0.0;
};

template <typename Sample>
std::optional<Bracket> Find(const std::vector<Sample>& samples, double time_s) {
  if (samples.empty()) return std::nullopt;
  if (time_s < samples.front().time_s - kTrackBeyond_s || time_s > samples.back().time_s + kTrackBeyond_s) return std::nullopt;
  if (samples.size() == 1) return Bracket{0, 0, 0.0};
  const auto after =
      std::upper_bound(samples.begin(), samples.end(), time_s, [](double t, const Sample& sample) { return t < sample.time_s; });
  const std::size_t b = std::clamp<std::size_t>(static_cast<std::size_t>(after - samples.begin()), 1, samples.size() - 1);
  const double gap_s = samples[b].time_s - samples[b - 1].time_s;
  const double t = (time_s - samples[b - 1].time_s) / gap_s;
  if (gap_s <= kTrackGap_s && t >= 0.0 && t <= 1.0) return Bracket{b - 1, b, t};
  // In a gap or beyond an end: a sample that is near enough stands for it.
  for (const std::size_t i : {b - 1, b}) {
    if (std::abs(samples[i].time_s - time_s) <= (t >= 0.0 && t <= 1.0 ? kSame_s : kTrackBeyond_s)) {
      if (gap_s > kTrackGap_s || std::abs(samples[i].time_s - time_s) <= kSame_s) return Bracket{i, i, 0.0};
      return Bracket{b - 1, b, t};
    }
  }
  return std::nullopt;
}

}  // namespace

TelemetryTrack::TelemetryTrack(std::vector<CameraSample> samples) : samples_(std::move(samples)) {
  std::vector<double> intervals_s;
  for (std::size_t i = 1; i < samples_.size(); ++i) {
    intervals_s.push_back(samples_[i].time_s - samples_[i - 1].time_s);
    TREM_CHECK(intervals_s.back() > 0.0);
  }
  if (!intervals_s.empty()) {
    const auto middle = intervals_s.begin() + static_cast<std::ptrdiff_t>(intervals_s.size() / 2);
    std::nth_element(intervals_s.begin(), middle, intervals_s.end());
    interval_s_ = *middle;
  }
  MeasureUncertainty();
}

void TelemetryTrack::MeasureUncertainty() {
  double position = 0.0;
  double attitude = 0.0;
  double count = 0.0;
  for (std::size_t i = 1; i + 1 < samples_.size(); ++i) {
    const double span_s = samples_[i + 1].time_s - samples_[i - 1].time_s;
    if (span_s > 2.0 * kTrackGap_s) continue;
    const double t = (samples_[i].time_s - samples_[i - 1].time_s) / span_s;
    const CameraSample predicted = Between(samples_[i - 1], samples_[i + 1], t);
    const CameraSample& seen = samples_[i];
    // To what it would be in the middle of two median intervals.
    const double factor = (interval_s_ * interval_s_) / (std::max(0.05, t * (1.0 - t)) * span_s * span_s);
    const double east =
        std::remainder(predicted.longitude_deg - seen.longitude_deg, 360.0) * kMetresPerDegree * std::cos(seen.latitude_deg * kRad);
    const double north = (predicted.latitude_deg - seen.latitude_deg) * kMetresPerDegree;
    const double up = predicted.altitude_m - seen.altitude_m;
    const double turn = Rotation(predicted).angularDistance(Rotation(seen)) / kRad;
    position += factor * factor * (east * east + north * north + up * up);
    attitude += factor * factor * turn * turn;
    count += 1.0;
  }
  if (count > 0.0) miss_ = {std::sqrt(position / count), std::sqrt(attitude / count)};
}

std::optional<TrackPose> TelemetryTrack::At(double time_s) const {
  const std::optional<Bracket> bracket = Find(samples_, time_s);
  if (!bracket.has_value()) return std::nullopt;
  const CameraSample& a = samples_[bracket->a];
  const CameraSample& b = samples_[bracket->b];
  TrackPose pose;
  pose.camera = bracket->a == bracket->b ? a : Between(a, b, bracket->t);
  const double nearest_s = std::min(std::abs(time_s - a.time_s), std::abs(time_s - b.time_s));
  pose.interpolated = nearest_s > kSame_s;
  if (!pose.interpolated || interval_s_ <= 0.0) return pose;
  // A sample saw the bend over two intervals, h^2 x'' / 2; between samples a gap apart it is s (1 - s) gap^2 x'' / 2.
  const double gap_s = b.time_s - a.time_s;
  const double s = bracket->a == bracket->b ? 0.0 : bracket->t;
  const double bend = bracket->a == bracket->b ? 1.0 : std::abs(s * (1.0 - s)) * (gap_s * gap_s) / (interval_s_ * interval_s_);
  pose.uncertainty = {bend * miss_.position_m, bend * miss_.attitude_deg};
  return pose;
}

std::optional<std::array<GeoPoint, 4>> CornersAt(const std::vector<CornerSample>& samples, double time_s) {
  const std::optional<Bracket> bracket = Find(samples, time_s);
  if (!bracket.has_value()) return std::nullopt;
  std::array<GeoPoint, 4> corners;
  for (std::size_t k = 0; k < 4; ++k) {
    const GeoPoint& a = samples[bracket->a].corners[k];
    const GeoPoint& b = samples[bracket->b].corners[k];
    corners[k] = {Blend(a.latitude_deg, b.latitude_deg, bracket->t),
                  std::remainder(BlendAngle(a.longitude_deg, b.longitude_deg, bracket->t), 360.0)};
  }
  return corners;
}

}  // namespace trem
