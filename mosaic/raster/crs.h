#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>

#include "mosaic/base/status.h"

namespace trem {

// Coordinate reference systems, by way of GDAL's OSR (PROJ). Axis order everywhere is GIS: x = longitude or easting, y = latitude or
// northing, whatever the authority's definition says.

// EPSG code of the WGS 84 / UTM zone that holds the point: 32601..32660 (north), 32701..32760 (south). The exceptions of Norway and
// Svalbard are not made: any zone near the area serves. Preconditions: |latitude| <= 90, longitude finite.
int UtmEpsg(double latitude_deg, double longitude_deg);

// WKT of a CRS given as anything GDAL understands without reading files or the network ("EPSG:32630", WKT, PROJ string).
// kInvalidInput that names `crs` when it is unknown.
Result<std::string> CrsWkt(const std::string& crs);

// The EPSG code that a WKT names as its own; none when it names none.
std::optional<int> EpsgOf(const std::string& crs_wkt);
// The same CRS as WKT 2 (ISO 19162:2019), on one line; empty when the WKT is not valid.
std::string Wkt2(const std::string& crs_wkt);

// An engineering CRS named "local, sensor pixels": what a mosaic without telemetry lies in. Unit: one sensor pixel.
std::string LocalPixelCrsWkt();

// A metric map frame: a projected CRS with metres as its unit, and its relation to WGS 84 latitude and longitude.
//
// Cost: a few microseconds a point. Not thread-safe (PROJ contexts are not); make one per thread.
class UtmFrame {
 public:
  // The UTM zone of the point. kInvalidInput when the point is not on Earth.
  static Result<UtmFrame> ForPoint(double latitude_deg, double longitude_deg);
  // Any projected CRS in metres. kInvalidInput when unknown, geographic, or in other units: a ground sample distance is in metres.
  static Result<UtmFrame> ForCrs(const std::string& crs);

  UtmFrame(UtmFrame&&) noexcept;
  UtmFrame& operator=(UtmFrame&&) noexcept;
  ~UtmFrame();

  const std::string& wkt() const;
  // (easting, northing) [m]. kInvalidInput when the projection does not reach the point.
  Result<Eigen::Vector2d> Forward(double latitude_deg, double longitude_deg) const;
  // (latitude, longitude) [deg] of (easting, northing) [m].
  Result<Eigen::Vector2d> Inverse(const Eigen::Vector2d& x_in_map) const;
  // Meridian convergence: the clockwise angle from true north to grid north at the point [rad]. grid bearing = true bearing - this.
  Result<double> ConvergenceRad(double latitude_deg, double longitude_deg) const;
  // Map distance / distance on the ellipsoid at the point (square root of the area scale).
  Result<double> ScaleFactor(double latitude_deg, double longitude_deg) const;

 private:
  struct State;
  explicit UtmFrame(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
