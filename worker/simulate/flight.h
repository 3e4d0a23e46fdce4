#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "worker/simulate/options.h"
#include "worker/simulate/truth.h"

namespace trem {

// Where a camera stands and looks, in the map frame of the truth: x easting, y northing [map metres], z up from the ground plane
// [metres]. A ground offset of one metre is `map_scale` map metres.
struct CameraState {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  double height_m = 0.0;
  double map_scale = 1.0;
  // Columns: the image's right, the image's bottom, the optical axis; rows: grid east, grid north, up.
  Eigen::Matrix3d map_from_camera = Eigen::Matrix3d::Identity();
  // Height of the ground above the plane [metres] over the map; lent by Truth::relief. Null: flat.
  const GroundSurface* relief = nullptr;
};

// Map point where the ray along `direction` (rows east, north, up) of a camera meets the ground. Precondition: it descends.
Eigen::Vector2d MeetGround(const CameraState& camera, const Eigen::Vector3d& direction);

// Angles as telemetry.csv gives them, but in radians.
struct Attitude {
  double yaw_rad = 0.0;  // From the north of the frame at hand.
  double pitch_rad = 0.0;
  double roll_rad = 0.0;
};

// One line of telemetry.
struct TelemetryRow {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  double altitude_m = 0.0;
  Attitude attitude;  // Yaw from TRUE north.
};

// One exposure of a simulated sortie.
struct Exposure {
  int index = 0;
  double time_s = 0.0;
  bool dropped = false;
  CameraState camera;
  TelemetryRow true_row;
  TelemetryRow reported_row;  // With the errors of the instruments.
  double gain = 1.0;
  double offset = 0.0;
};

struct Flight {
  std::vector<Exposure> exposures;
  Eigen::Vector2d gps_bias_m = Eigen::Vector2d::Zero();  // (east, north), map metres.
  double focal_px = 0.0;
  double speed_px = 0.0;  // Ground motion per frame.
  // Box around everything that the sensor sees, map metres.
  Eigen::Vector2d seen_min_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d seen_max_m = Eigen::Vector2d::Zero();
};

// Rotation of a camera with the given attitude: columns right, bottom, axis; rows east, north, up of the frame that yaw counts in.
Eigen::Matrix3d RotationFromAttitude(const Attitude& attitude);
// The inverse. Straight down, where yaw and roll are one angle, yaw is 0.
Attitude AttitudeFromRotation(const Eigen::Matrix3d& rotation);

// Ground point [map metres] that sensor position `u` [px] of a camera sees. Precondition: its ray descends.
Eigen::Vector2d GroundFromPixel(const CameraState& camera, double focal_px, int width_px, int height_px, const Eigen::Vector2d& u);
// Sensor position that sees the ground point. Precondition: the point is in front of the camera.
Eigen::Vector2d PixelFromGround(const CameraState& camera, double focal_px, int width_px, int height_px, const Eigen::Vector2d& ground);

// Plans the flight so that every exposure, with a margin for the point spread function, stays inside the truth. kInvalidInput, with what
// to change, when the truth is too small for the footprint or for the length of the path.
Result<Flight> PlanFlight(const SimulationOptions& options, const Truth& truth);

}  // namespace trem
