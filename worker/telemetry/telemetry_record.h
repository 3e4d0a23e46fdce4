#pragma once

#include <array>
#include <cstdint>
#include <optional>

namespace trem {

// WGS 84 degrees.
struct GeoPoint {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
};

// What a source of telemetry says about one moment, as it says it: nothing is derived and no convention is chosen yet (that is the
// audit's business, telemetry_audit.h). Angles in degrees, because that is what sources and messages about them speak.
struct TelemetryRecord {
  double time_s = 0.0;                 // On the clock of the frames' times.
  std::optional<std::int64_t> utc_us;  // Since 1970-01-01, as the source states it.

  std::optional<GeoPoint> sensor;
  std::optional<double> altitude_msl_m;  // Of the sensor, above mean sea level...
  std::optional<double> altitude_hae_m;  // ... and above the WGS 84 ellipsoid.

  std::optional<double> platform_heading_deg;  // Clockwise from north, of the nose.
  std::optional<double> platform_pitch_deg;    // Nose up.
  std::optional<double> platform_roll_deg;     // Right wing down.
  // By the standards relative to the platform: clockwise from the nose, up from its floor, clockwise seen from behind the camera. Sources
  // that are not to be believed in this put absolute angles here.
  std::optional<double> sensor_azimuth_deg;
  std::optional<double> sensor_elevation_deg;
  std::optional<double> sensor_roll_deg;
  std::optional<double> hfov_deg;
  std::optional<double> vfov_deg;

  // Redundant: follows from the above and the ground.
  std::optional<double> slant_range_m;
  std::optional<GeoPoint> frame_centre;
  std::optional<double> centre_elevation_msl_m;
  std::optional<double> centre_elevation_hae_m;
  std::optional<std::array<GeoPoint, 4>> corners;  // Outer corners of the image: upper left, upper right, lower right, lower left.

  bool HasPosition() const { return sensor.has_value() && (altitude_msl_m.has_value() || altitude_hae_m.has_value()); }
  bool HasPointing() const { return sensor_azimuth_deg.has_value() && sensor_elevation_deg.has_value(); }
  bool HasFieldOfView() const { return hfov_deg.has_value() || vfov_deg.has_value(); }
};

}  // namespace trem
