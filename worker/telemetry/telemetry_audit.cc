#include "worker/telemetry/telemetry_audit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "mosaic/raster/elevation_model.h"
#include "worker/telemetry/audit_geometry.h"
#include "worker/telemetry/corner_checks.h"

namespace trem {
namespace {

using Ground = TelemetryConvention::Ground;

constexpr double kRad = std::numbers::pi / 180.0;
constexpr std::size_t kRecordsTried = 200;
constexpr double kToleranceMin_m = 10.0;
constexpr double kToleranceOfRange = 0.01;
// A convention that comes before another in preference is kept when its score is at most this much worse.
constexpr double kTieFactor = 1.1;
constexpr double kTie_m = 0.3;
// Nobody sees ground farther than this from a turret.
constexpr double kRangeMax_m = 400e3;

double Quantile(std::vector<double> values, double p) {
  if (values.empty()) return -1.0;
  const auto rank = values.begin() + static_cast<std::ptrdiff_t>(p * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), rank, values.end());
  return *rank;
}

struct Candidate {
  TelemetryConvention convention;
  AuditResidual residual;
};

std::string ResidualText(const AuditResidual& residual) {
  std::string text;
  const auto add = [&text](const char* what, double value, double high) {
    if (value < 0.0) return;
    text += fmt::format("{}{} {:.2f} m", text.empty() ? "" : ", ", what, value);
    if (high >= 0.0) text += fmt::format(" (95 %: {:.2f} m)", high);
  };
  add("frame centre", residual.centre_m, residual.centre_95_m);
  add("corners", residual.corners_m, residual.corners_95_m);
  add("slant range", residual.slant_m, -1.0);
  return text;
}

class Audit {
 public:
  Audit(const std::vector<TelemetryRecord>& records, const AuditOptions& options) : records_(records), options_(options) {}

  TelemetryAudit Run() {
    DropNoFix();
    corner_check_ = CheckCorners(records_);
    for (const std::string& doubt : corner_check_.doubts) result_.doubts.push_back(doubt);
    if (!FindWorld()) return Fallback("it states no place at all");
    PrepareRecords();
    const std::string missing = WhatIsMissing();
    if (!missing.empty()) return Fallback(missing);
    TryAll();
    return Decide();
  }

 private:
  // 0 N 0 E is what receivers without a fix report.
  void DropNoFix() {
    const auto is_zero = [](const GeoPoint& at) { return std::abs(at.latitude_deg) < 1e-7 && std::abs(at.longitude_deg) < 1e-7; };
    int zero = 0;
    for (TelemetryRecord& record : records_) {
      if (record.sensor.has_value() && is_zero(*record.sensor)) {
        record.sensor.reset();
        ++zero;
      }
      if (record.frame_centre.has_value() && is_zero(*record.frame_centre)) record.frame_centre.reset();
    }
    if (zero > 0) {
      result_.doubts.push_back(
          fmt::format("{} of {} records place the sensor at latitude 0, longitude 0: a receiver without a fix; they count as "
                      "without a position",
                      zero, records_.size()));
    }
  }

  std::optional<GeoPoint> SomePlace() const {
    std::vector<GeoPoint> places;
    for (const TelemetryRecord& record : records_) {
      if (record.sensor.has_value()) {
        places.push_back(*record.sensor);
      } else if (record.frame_centre.has_value()) {
        places.push_back(*record.frame_centre);
      }
    }
    return places.empty() ? std::nullopt : std::optional<GeoPoint>(places[places.size() / 2]);
  }

  bool FindWorld() {
    const std::optional<GeoPoint> place = SomePlace();
    if (!place.has_value()) return false;
    Result<UtmFrame> map = UtmFrame::ForPoint(place->latitude_deg, place->longitude_deg);
    if (!map.ok()) return false;
    const Result<Eigen::Vector2d> origin = map->Forward(place->latitude_deg, place->longitude_deg);
    const Result<double> scale = map->ScaleFactor(place->latitude_deg, place->longitude_deg);
    if (!origin.ok() || !scale.ok()) return false;
    origin_ = *origin;
    scale_ = *scale;
    map_.emplace(std::move(*map));
    if (options_.surface != nullptr) {
      const auto* gridded = dynamic_cast<const GriddedGround*>(options_.surface);
      TREM_CHECK(gridded != nullptr);
      Result<GriddedGround> surface = GroundInWorld(*gridded, *map_, origin_, scale_);
      if (surface.ok()) surface_.emplace(std::move(*surface));
    }
    return true;
  }

  std::optional<Eigen::Vector2d> InWorld(const GeoPoint& at) const {
    const Result<Eigen::Vector2d> x = map_->Forward(at.latitude_deg, at.longitude_deg);
    if (!x.ok()) return std::nullopt;
    return Eigen::Vector2d((*x - origin_) / scale_);
  }

  void PrepareRecords() {
    const std::size_t step = (records_.size() + kRecordsTried - 1) / kRecordsTried;
    for (std::size_t i = 0; i < records_.size(); i += std::max<std::size_t>(1, step)) {
      const TelemetryRecord& record = records_[i];
      AuditRecord tried;
      tried.record = &record;
      if (record.sensor.has_value()) {
        tried.sensor = InWorld(*record.sensor);
        tried.convergence_rad = ConvergenceAt(*record.sensor);
      }
      if (record.frame_centre.has_value()) tried.centre = InWorld(*record.frame_centre);
      if (record.corners.has_value()) tried.corners = CornersInWorld(*record.corners);
      if (record.hfov_deg.has_value()) tried.tan_half_hfov = std::tan(0.5 * *record.hfov_deg * kRad);
      if (record.vfov_deg.has_value()) tried.tan_half_vfov = std::tan(0.5 * *record.vfov_deg * kRad);
      if (tried.tan_half_hfov == 0.0) tried.tan_half_hfov = tried.tan_half_vfov * options_.aspect;
      if (tried.tan_half_vfov == 0.0) tried.tan_half_vfov = tried.tan_half_hfov / options_.aspect;
      tried_.push_back(tried);
    }
  }

  double ConvergenceAt(const GeoPoint& at) const {
    const Result<double> convergence = map_->ConvergenceRad(at.latitude_deg, at.longitude_deg);
    return convergence.ok() ? *convergence : 0.0;
  }

  std::optional<std::array<Eigen::Vector2d, 4>> CornersInWorld(const std::array<GeoPoint, 4>& corners) const {
    std::array<Eigen::Vector2d, 4> x;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::optional<Eigen::Vector2d> corner = InWorld(corners[k]);
      if (!corner.has_value()) return std::nullopt;
      x[k] = *corner;
    }
    return x;
  }

  template <typename F>
  bool Any(F has) const {
    return std::any_of(records_.begin(), records_.end(), has);
  }

  // Of what a pose takes, in words; empty: nothing.
  std::string WhatIsMissing() {
    std::string missing;
    const auto add = [&missing](const std::string& what) { missing += (missing.empty() ? "it lacks " : ", ") + what; };
    if (!Any([](const TelemetryRecord& r) { return r.sensor.has_value(); })) add("the sensor's position");
    if (!Any([](const TelemetryRecord& r) { return r.altitude_msl_m.has_value() || r.altitude_hae_m.has_value(); }))
      add("the sensor's altitude");
    if (!Any([](const TelemetryRecord& r) { return r.HasPointing(); })) add("the sensor's azimuth and elevation");
    if (!Any([](const TelemetryRecord& r) { return r.HasFieldOfView(); })) add("the field of view");
    if (missing.empty() && !Any([](const TelemetryRecord& r) { return r.HasPosition() && r.HasPointing() && r.HasFieldOfView(); }))
      add("a record that has position, attitude and field of view together");
    return missing;
  }

  // A place that the sensor cannot see: latitude and longitude may have been exchanged.
  std::string Contradiction() const {
    std::vector<double> distances_m;
    std::vector<double> swapped_m;
    const auto distance = [](const GeoPoint& a, const GeoPoint& b) {
      const double north = (a.latitude_deg - b.latitude_deg) * 111320.0;
      const double east = std::remainder(a.longitude_deg - b.longitude_deg, 360.0) * 111320.0 * std::cos(a.latitude_deg * kRad);
      return std::hypot(north, east);
    };
    for (const TelemetryRecord& record : records_) {
      const std::optional<GeoPoint> seen = record.frame_centre.has_value() ? record.frame_centre
                                           : record.corners.has_value()    ? std::optional<GeoPoint>((*record.corners)[0])
                                                                           : std::nullopt;
      if (!record.sensor.has_value() || !seen.has_value()) continue;
      distances_m.push_back(distance(*record.sensor, *seen));
      swapped_m.push_back(distance({record.sensor->longitude_deg, record.sensor->latitude_deg}, *seen));
    }
    const double apart = Quantile(distances_m, 0.5);
    if (apart <= kRangeMax_m) return "";
    std::string text = fmt::format("the sensor and what it sees are {:.0f} km apart", 1e-3 * apart);
    if (Quantile(swapped_m, 0.5) < kRangeMax_m) {
      text += fmt::format(": latitude and longitude of the sensor look exchanged (exchanged back it would be {:.1f} km)",
                          1e-3 * Quantile(swapped_m, 0.5));
    }
    return text;
  }

  std::vector<std::pair<HeightReading, Ground>> Grounds() const {
    if (surface_.has_value()) return {{HeightReading::kMsl, Ground::kSurface}, {HeightReading::kEllipsoid, Ground::kSurface}};
    if (options_.ground_elevation_m.has_value())
      return {{HeightReading::kMsl, Ground::kGiven}, {HeightReading::kEllipsoid, Ground::kGiven}};
    return {{HeightReading::kMsl, Ground::kCentreMsl},
            {HeightReading::kEllipsoid, Ground::kCentreEllipsoid},
            {HeightReading::kMsl, Ground::kCentreEllipsoid},
            {HeightReading::kEllipsoid, Ground::kCentreMsl},
            {HeightReading::kMsl, Ground::kZero},
            {HeightReading::kEllipsoid, Ground::kZero}};
  }

  void TryAll() {
    for (const auto& [altitude, ground] : Grounds()) {
      for (const AzimuthReading azimuth : {AzimuthReading::kRelative, AzimuthReading::kRelativeLevel, AzimuthReading::kAbsolute}) {
        for (const NorthReading north : {NorthReading::kTrue, NorthReading::kGrid}) {
          for (const ElevationReading elevation : {ElevationReading::kUp, ElevationReading::kDown}) {
            const bool told = azimuth == AzimuthReading::kAbsolute && north == NorthReading::kTrue && elevation == ElevationReading::kUp;
            if (options_.absolute && !told) continue;
            const TelemetryConvention convention{azimuth, north, elevation, altitude, ground};
            candidates_.push_back({convention, Evaluate(convention)});
          }
        }
      }
    }
  }

  AuditResidual Evaluate(const TelemetryConvention& convention) const {
    std::vector<double> centre_m, corners_m, slant_m;
    int fit = 0;
    int able = 0;
    for (const AuditRecord& record : tried_) {
      if (!AltitudeOf(*record.record, convention).has_value() || !record.sensor.has_value()) continue;
      if (convention.ground != Ground::kSurface && !GroundOf(*record.record, convention, options_).has_value()) continue;
      ++able;
      const std::optional<Prediction> predicted = Predict(record, convention, options_, surface_.has_value() ? &*surface_ : nullptr);
      if (!predicted.has_value()) continue;
      ++fit;
      if (record.centre.has_value()) centre_m.push_back((predicted->centre - *record.centre).norm());
      if (record.record->slant_range_m.has_value()) slant_m.push_back(std::abs(predicted->slant_m - *record.record->slant_range_m));
      if (!record.corners.has_value() || record.tan_half_hfov <= 0.0) continue;
      double sum = 0.0;
      for (std::size_t k = 0; k < 4; ++k) sum += (predicted->corners[k] - (*record.corners)[k]).squaredNorm();
      corners_m.push_back(std::sqrt(0.25 * sum));
    }
    AuditResidual residual;
    residual.records = 2 * fit > able ? fit : 0;
    residual.centre_m = Quantile(centre_m, 0.5);
    residual.centre_95_m = Quantile(centre_m, 0.95);
    residual.corners_m = Quantile(corners_m, 0.5);
    residual.corners_95_m = Quantile(corners_m, 0.95);
    residual.slant_m = Quantile(slant_m, 0.5);
    return residual;
  }

  // The best candidate of those that `allowed` lets through; of nearly equal ones the first.
  template <typename F>
  const Candidate* Best(F allowed) const {
    double least = std::numeric_limits<double>::infinity();
    for (const Candidate& candidate : candidates_) {
      if (allowed(candidate.convention)) least = std::min(least, candidate.residual.score_m());
    }
    if (!std::isfinite(least)) return nullptr;
    for (const Candidate& candidate : candidates_) {
      if (allowed(candidate.convention) && candidate.residual.score_m() <= kTieFactor * least + kTie_m) return &candidate;
    }
    return nullptr;
  }

  double Tolerance(const TelemetryConvention& convention) const {
    std::vector<double> ranges_m;
    for (const AuditRecord& record : tried_) {
      const std::optional<Prediction> predicted = Predict(record, convention, options_, surface_.has_value() ? &*surface_ : nullptr);
      if (predicted.has_value()) ranges_m.push_back(predicted->slant_m);
    }
    return std::max(kToleranceMin_m, kToleranceOfRange * Quantile(ranges_m, 0.5));
  }

  TelemetryAudit Decide() {
    const Candidate* best = Best([](const TelemetryConvention&) { return true; });
    const bool stated =
        Any([](const TelemetryRecord& r) { return r.frame_centre.has_value() || r.corners.has_value() || r.slant_range_m.has_value(); });
    if (!stated) return Unchecked();
    const std::string contradiction = Contradiction();
    if (!contradiction.empty()) return Fallback(contradiction);
    if (best == nullptr) return Fallback("under no convention does the camera look down to the ground: check elevation angles and ground");
    const double tolerance_m = Tolerance(best->convention);
    if (best->residual.score_m() > tolerance_m) return Fallback(WhyNoneFits(*best, tolerance_m));
    result_.verdict = AuditVerdict::kFits;
    Accept(*best);
    result_.explanation = ToString(best->convention) + GroundText() + " predicts " + ResidualText(best->residual) + Alternatives(*best);
    return std::move(result_);
  }

  TelemetryAudit Unchecked() {
    // Nothing tells the conventions apart: the standards' reading of what is there.
    for (const Candidate& candidate : candidates_) {
      if (candidate.residual.records == 0) continue;
      result_.verdict = AuditVerdict::kUnchecked;
      Accept(candidate);
      result_.explanation =
          ToString(candidate.convention) + GroundText() + ", unchecked: no frame centre, corners or slant range to compare with";
      return std::move(result_);
    }
    return Fallback("the camera looks above the horizon, or stands below the ground, in most records");
  }

  std::string WhyNoneFits(const Candidate& best, double tolerance_m) const {
    std::string text = fmt::format("no convention fits: the best, {}, predicts {}; expected at most {:.0f} m", ToString(best.convention),
                                   ResidualText(best.residual), tolerance_m);
    const bool pointing_fits = best.residual.centre_m >= 0.0 && best.residual.centre_m <= tolerance_m;
    const double factor = pointing_fits ? FieldOfViewFactor(best.convention) : 1.0;
    if (factor > 1.2 || factor < 1.0 / 1.2) {
      text += fmt::format("; the stated corners are {:.3g} times as far apart as the field of view allows", factor);
      if (std::abs(factor * kRad - 1.0) < 0.2) text += ": it looks like radians, expected degrees";
    }
    return text;
  }

  // Size of the stated footprints over that of the predicted ones.
  double FieldOfViewFactor(const TelemetryConvention& convention) const {
    std::vector<double> factors;
    for (const AuditRecord& record : tried_) {
      if (!record.corners.has_value() || record.tan_half_hfov <= 0.0) continue;
      const auto predicted = Predict(record, convention, options_, surface_.has_value() ? &*surface_ : nullptr);
      if (!predicted.has_value()) continue;
      const double stated = ((*record.corners)[2] - (*record.corners)[0]).norm() + ((*record.corners)[3] - (*record.corners)[1]).norm();
      const double expected =
          (predicted->corners[2] - predicted->corners[0]).norm() + (predicted->corners[3] - predicted->corners[1]).norm();
      if (expected > 0.0) factors.push_back(stated / expected);
    }
    return factors.empty() ? 1.0 : Quantile(factors, 0.5);
  }

  // The best of every other reading of azimuth and north.
  std::string Alternatives(const Candidate& best) const {
    std::string text;
    for (const AzimuthReading azimuth : {AzimuthReading::kRelative, AzimuthReading::kRelativeLevel, AzimuthReading::kAbsolute}) {
      for (const NorthReading north : {NorthReading::kTrue, NorthReading::kGrid}) {
        if (azimuth == best.convention.azimuth && north == best.convention.north) continue;
        const Candidate* other = Best([&](const TelemetryConvention& c) { return c.azimuth == azimuth && c.north == north; });
        if (other == nullptr) continue;
        TelemetryConvention angles = other->convention;
        text += fmt::format("{} {} {:.3g} m", text.empty() ? "; others:" : ",", ToString(angles), other->residual.score_m());
      }
    }
    return text;
  }

  std::string GroundText() const {
    return surface_.has_value() ? ", ground from the elevation model" : fmt::format(", ground at {:.1f} m", result_.ground_elevation_m);
  }

  void Accept(const Candidate& candidate) {
    const TelemetryConvention& convention = candidate.convention;
    result_.convention = convention;
    result_.residual = candidate.residual;
    result_.ground_known = convention.ground != Ground::kZero || result_.verdict == AuditVerdict::kFits;
    std::vector<double> elevations_m;
    for (const TelemetryRecord& record : records_) {
      const std::optional<double> ground_m = GroundOf(record, convention, options_);
      if (ground_m.has_value()) elevations_m.push_back(*ground_m);
      AddPose(record, convention);
    }
    if (surface_.has_value()) {
      result_.ground_elevation_m = surface_->mean_m();
    } else if (!elevations_m.empty()) {
      const auto [low, high] = std::minmax_element(elevations_m.begin(), elevations_m.end());
      result_.ground_spread_m = *high - *low;
      result_.ground_elevation_m = Quantile(elevations_m, 0.5);
    }
    result_.corners = std::move(corner_check_.plausible);
  }

  void AddPose(const TelemetryRecord& record, const TelemetryConvention& convention) {
    const std::optional<double> altitude_m = AltitudeOf(record, convention);
    const std::optional<Eigen::Matrix3d> rotation = CameraRotation(record, convention);
    if (!record.sensor.has_value() || !altitude_m.has_value() || !rotation.has_value() || !record.HasFieldOfView()) return;
    const Eigen::Vector3d angles = AnglesOfRotation(*rotation);
    const double to_true = convention.north == NorthReading::kGrid ? ConvergenceAt(*record.sensor) : 0.0;
    result_.poses.push_back({record.time_s, record.sensor->latitude_deg, record.sensor->longitude_deg, *altitude_m,
                             std::remainder((angles[0] + to_true) / kRad, 360.0), angles[1] / kRad, angles[2] / kRad, record.hfov_deg,
                             record.vfov_deg});
  }

  // The poses cannot be used because `reason`: the corners, if there are any.
  TelemetryAudit Fallback(const std::string& reason) {
    const bool far = reason.find("km apart") != std::string::npos;
    if (corner_check_.plausible.empty() || far) {
      result_.verdict = AuditVerdict::kRefused;
      result_.explanation = reason + (far ? "; expected the ground within sight of the sensor" : ", and it states no usable image corners");
      return std::move(result_);
    }
    result_.verdict = AuditVerdict::kCorners;
    result_.corners = std::move(corner_check_.plausible);
    result_.explanation = "the stated image corners are used, no poses, because " + reason;
    return std::move(result_);
  }

  std::vector<TelemetryRecord> records_;
  const AuditOptions& options_;
  TelemetryAudit result_;
  CornerCheck corner_check_;
  std::optional<UtmFrame> map_;
  Eigen::Vector2d origin_ = Eigen::Vector2d::Zero();
  double scale_ = 1.0;
  std::optional<GriddedGround> surface_;
  std::vector<AuditRecord> tried_;
  std::vector<Candidate> candidates_;
};

}  // namespace

std::string ToString(const TelemetryConvention& convention) {
  std::string text = convention.azimuth == AzimuthReading::kRelative        ? "sensor azimuth relative to the platform, "
                     : convention.azimuth == AzimuthReading::kRelativeLevel ? "sensor azimuth relative to the heading, mount level, "
                                                                            : "absolute sensor azimuth, ";
  text += convention.north == NorthReading::kTrue ? "true north" : "grid north";
  if (convention.elevation == ElevationReading::kDown) text += ", elevation positive down";
  if (convention.altitude == HeightReading::kEllipsoid) text += ", heights above the ellipsoid";
  return text;
}

double AuditResidual::score_m() const {
  if (records == 0) return std::numeric_limits<double>::infinity();
  double sum = 0.0;
  int count = 0;
  for (const double value : {centre_m, corners_m, slant_m}) {
    if (value < 0.0) continue;
    sum += value * value;
    ++count;
  }
  return count == 0 ? std::numeric_limits<double>::infinity() : std::sqrt(sum / count);
}

TelemetryAudit AuditTelemetry(const std::vector<TelemetryRecord>& records, const AuditOptions& options) {
  if (records.empty()) {
    TelemetryAudit nothing;
    nothing.explanation = "it has no records";
    return nothing;
  }
  return Audit(records, options).Run();
}

}  // namespace trem
