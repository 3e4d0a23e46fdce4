#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// A camera pose at a moment, in the conventions of telemetry.csv (docs/USER_GUIDE.md): WGS 84, yaw of the optical axis from true north.
struct CameraSample {
  double time_s = 0.0;
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  double altitude_m = 0.0;
  double yaw_deg = 0.0;
  double pitch_deg = 0.0;
  double roll_deg = 0.0;
  std::optional<double> hfov_deg;  // At least one of the two.
  std::optional<double> vfov_deg;
};

struct CornerSample {
  double time_s = 0.0;
  std::array<GeoPoint, 4> corners;  // Upper left, upper right, lower right, lower left.
};

// How a source's angles and heights are to be read. Of equally good ones the audit prefers the first, the standards' reading.
enum class AzimuthReading {
  kRelative,       // Sensor angles turned by the platform's heading, pitch and roll: ST 0601.
  kRelativeLevel,  // By the heading alone: a stabilised mount that reports angles about the vertical.
  kAbsolute,       // Sensor azimuth from north, elevation from the horizon; the platform's attitude does not matter.
};
enum class NorthReading { kTrue, kGrid };    // Grid: of the UTM zone.
enum class ElevationReading { kUp, kDown };  // Positive above the horizon; or below it.
enum class HeightReading { kMsl, kEllipsoid };

struct TelemetryConvention {
  AzimuthReading azimuth = AzimuthReading::kRelative;
  NorthReading north = NorthReading::kTrue;
  ElevationReading elevation = ElevationReading::kUp;
  HeightReading altitude = HeightReading::kMsl;
  // Where the ground is: the frame centre's elevation in one datum or the other, or `ground_elevation_m`, or a surface that was given.
  enum class Ground { kGiven, kSurface, kCentreMsl, kCentreEllipsoid, kZero } ground = Ground::kZero;
};

std::string ToString(const TelemetryConvention& convention);

// Predicted minus stated, in metres: median and 95 % quantile over the records. -1: not stated.
struct AuditResidual {
  int records = 0;
  double centre_m = -1.0;
  double centre_95_m = -1.0;
  double corners_m = -1.0;  // Rms over the four corners of a record.
  double corners_95_m = -1.0;
  double slant_m = -1.0;
  // Rms of the medians that are there; infinite when there is none or when most rays do not meet the ground.
  double score_m() const;
};

struct AuditOptions {
  double aspect = 4.0 / 3.0;                 // Width over height of the image in square pixels: where one field of view is missing.
  std::optional<double> ground_elevation_m;  // Given by the user: the only ground that is tried...
  const GroundSurface* surface = nullptr;    // ... but for this one, over longitude and latitude in degrees.
  // Azimuth and elevation are known to be absolute and from true north (EXIF, SRT and the like, whose makers say so).
  bool absolute = false;
};

enum class AuditVerdict {
  kFits,       // Poses; the redundant fields agree with them.
  kUnchecked,  // Poses; there is nothing to check them with.
  kCorners,    // The image corners that the source states; its poses are not usable.
  kRefused,    // Nothing is usable.
};

struct TelemetryAudit {
  AuditVerdict verdict = AuditVerdict::kRefused;
  TelemetryConvention convention;
  AuditResidual residual;           // Under `convention`.
  std::string explanation;          // What was chosen and why, with the residuals of the alternatives: one line.
  std::vector<std::string> doubts;  // What looks wrong: a line each.
  double ground_elevation_m = 0.0;  // In the datum of the poses' altitude.
  double ground_spread_m = 0.0;     // Of the stated elevations: largest minus smallest.
  bool ground_known = false;        // From the user, a surface or the source; else 0 was assumed and nothing contradicts.
  std::vector<CameraSample> poses;
  std::vector<CornerSample> corners;  // Of all records that state plausible ones.
};

// Predicts frame centre, corners and slant range of `records` from position, attitude and field of view under every convention, keeps the
// one that fits (score at most 10 m or 1 % of the range to the ground), and makes poses of all records under it. At most 200 records,
// evenly spread, take part in the choice. `records` in the order of time.
TelemetryAudit AuditTelemetry(const std::vector<TelemetryRecord>& records, const AuditOptions& options);

}  // namespace trem
