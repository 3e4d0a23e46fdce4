#pragma once

#include <cstdint>
#include <string>

namespace trem {

enum class SimulatedPath { kLine, kLawnmower, kDwell };

// What to simulate. Angles in degrees here because these are the user's options; everything behind them is in radians.
struct SimulationOptions {
  // Truth raster, anything GDAL reads. Empty: a procedural terrain from `seed`.
  std::string truth_path;
  int terrain_width_cells = 2400;
  int terrain_height_cells = 1500;

  // Place of the truth's centre, WGS 84. The UTM zone follows from it.
  double origin_lat_deg = 51.0;
  double origin_lon_deg = -1.5;
  double ground_elevation_m = 50.0;
  // Hills, peak to peak, about that elevation. Written to truth/dem.tif.
  double relief_m = 0.0;

  // Sensor.
  int width_px = 256;
  int height_px = 200;
  double gsd_m = 0.3;            // Across the line of sight, at the image centre, in metres of the map.
  double cells_per_pixel = 3.0;  // Truth cells along one sensor pixel at the image centre.
  double hfov_deg = 5.0;         // Sets the distance: a narrow field from far away or a wide one from near.
  double psf_sigma_px = 0.6;     // Gaussian optics.
  double fill_factor = 0.9;      // Side of the detector's box, pixels.
  int bit_depth = 8;             // 8, or 16: then a grey level is 256 counts.

  // Photometry, in grey levels of an 8-bit sensor: frame = gain * truth + offset.
  double gain = 0.8;
  double offset = 20.0;
  double gain_drift = 0.03;   // Standard deviation of the smooth drift, relative.
  double offset_drift = 2.0;  // Grey levels.
  double vignetting = 0.0;    // Part of the light, offset included, that the image's corners lose; grows with the square of the distance.
  double exposure_step = 0.0;  // Relative step of the gain, up and down in turn, five times in a sortie.
  double noise_sigma = 2.0;
  double shot_noise = 0.0;       // Variance per grey level, on top of noise_sigma^2.
  double fixed_pattern_sigma = 0.0;
  double dead_pixel_fraction = 0.0;
  int mover_count = 0;

  // Flight.
  int frame_count = 200;
  SimulatedPath path = SimulatedPath::kLine;
  double pitch_deg = -90.0;
  double yaw_deg = 0.0;   // From true north.
  double speed_px = 0.0;  // Motion of the ground per frame at the image centre, sensor pixels. 0: chosen from path, truth and frames.
  double sidelap = 0.4;   // Of neighbouring legs of a lawnmower.
  double frame_rate_hz = 25.0;
  double wander_deg = 0.05;        // Amplitude of the slow attitude wander.
  double jitter_deg = 0.005;       // Standard deviation of the white attitude jitter.
  double position_wander_m = 0.3;  // Amplitude of the slow camera position wander, each axis.
  double drop_fraction = 0.0;      // Exposures that leave no frame.

  // Errors of the telemetry.
  double gps_bias_m = 1.0;           // Length of the constant horizontal error; its direction is random.
  double gps_noise_m = 0.1;          // White, each axis.
  double attitude_noise_deg = 0.05;  // White, about each camera axis.
  double attitude_bias_deg = 0.0;    // Constant, about each camera axis, random: standard deviation.
  // Ground control points, written to gcp.csv: each in three frames, its pixel off by white noise of control_noise_px.
  int control_count = 0;
  double control_noise_px = 0.2;

  std::uint64_t seed = 1;
  int thread_count = 0;  // 0: all cores. No influence on the bytes.
  bool overwrite = false;
};

}  // namespace trem
