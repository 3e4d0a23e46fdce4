#include "worker/simulate/records.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>
#include <vector>

#include "mosaic/base/file.h"
#include "worker/simulate/relief.h"
#include "worker/simulate/simulation.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kDegPerRad = 180.0 / std::numbers::pi;
constexpr std::uint64_t kRecordBytesMax = 64ULL << 20;
constexpr const char* kFramesHeader =
    "frame,time_s,easting_m,northing_m,height_above_ground_m,map_scale,right_e,right_n,right_u,bottom_e,bottom_n,bottom_u,axis_e,axis_n,"
    "axis_u,"
    "latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,gain,offset,gps_bias_e_m,gps_bias_n_m\n";

double WrapDegrees(double degrees) {
  const double wrapped = std::fmod(degrees, 360.0);
  return wrapped < 0.0 ? wrapped + 360.0 : wrapped;
}

std::string PoseText(const TelemetryRow& row) {
  return fmt::format("{:.10f},{:.10f},{:.4f},{:.8f},{:.8f},{:.8f}", row.latitude_deg, row.longitude_deg, row.altitude_m,
                     WrapDegrees(row.attitude.yaw_rad * kDegPerRad), row.attitude.pitch_rad * kDegPerRad,
                     row.attitude.roll_rad * kDegPerRad);
}

std::string TelemetryCsv(const SimulationOptions& options, const Flight& flight) {
  std::string text = "frame,time_s,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg,vfov_deg,ground_elevation_m\n";
  const double vfov_deg = 2.0 * std::atan(0.5 * options.height_px / flight.focal_px) * kDegPerRad;
  for (const Exposure& exposure : flight.exposures) {
    if (exposure.dropped) continue;
    text += fmt::format("{},{:.6f},{},{:.8f},{:.8f},{:.4f}\n", FrameName(exposure.index), exposure.time_s, PoseText(exposure.reported_row),
                        options.hfov_deg, vfov_deg, options.ground_elevation_m);
  }
  return text;
}

std::string FramesCsv(const Flight& flight) {
  std::string text = kFramesHeader;
  for (const Exposure& exposure : flight.exposures) {
    if (exposure.dropped) continue;
    const CameraState& camera = exposure.camera;
    text += fmt::format("{},{:.6f},{:.6f},{:.6f},{:.6f},{:.12f}", FrameName(exposure.index), exposure.time_s, camera.position_m.x(),
                        camera.position_m.y(), camera.height_m, camera.map_scale);
    for (int column = 0; column < 3; ++column) {
      for (int row = 0; row < 3; ++row) text += fmt::format(",{:.15f}", camera.map_from_camera(row, column));
    }
    text += fmt::format(",{},{:.8f},{:.8f},{:.6f},{:.6f}\n", PoseText(exposure.true_row), exposure.gain, exposure.offset,
                        flight.gps_bias_m.x(), flight.gps_bias_m.y());
  }
  return text;
}

const char* PathName(SimulatedPath path) {
  switch (path) {
    case SimulatedPath::kLine:
      return "line";
    case SimulatedPath::kLawnmower:
      return "lawnmower";
    case SimulatedPath::kDwell:
      return "dwell";
  }
  return "?";
}

Json SimulationJson(const SimulationOptions& o, const Truth& truth, const Flight& flight) {
  return Json{{"truth", o.truth_path.empty() ? "procedural" : fs::path(o.truth_path).filename().string()},
              {"truth_width_cells", truth.grey.width()},
              {"truth_height_cells", truth.grey.height()},
              {"truth_cell_m", truth.cell_m()},
              {"truth_cells_per_pixel", o.cells_per_pixel},
              {"origin_lat_deg", o.origin_lat_deg},
              {"origin_lon_deg", o.origin_lon_deg},
              {"ground_elevation_m", o.ground_elevation_m},
              {"relief_m", o.relief_m},
              {"width_px", o.width_px},
              {"height_px", o.height_px},
              {"sensor_gsd_m", o.gsd_m},
              {"hfov_deg", o.hfov_deg},
              {"focal_px", flight.focal_px},
              {"psf_sigma_px", o.psf_sigma_px},
              {"fill_factor", o.fill_factor},
              {"bit_depth", o.bit_depth},
              {"gain", o.gain},
              {"offset", o.offset},
              {"gain_drift", o.gain_drift},
              {"offset_drift", o.offset_drift},
              {"vignetting", o.vignetting},
              {"exposure_step", o.exposure_step},
              {"noise_sigma", o.noise_sigma},
              {"shot_noise", o.shot_noise},
              {"fixed_pattern_sigma", o.fixed_pattern_sigma},
              {"dead_pixel_fraction", o.dead_pixel_fraction},
              {"mover_count", o.mover_count},
              {"frame_count", o.frame_count},
              {"path", PathName(o.path)},
              {"pitch_deg", o.pitch_deg},
              {"yaw_deg", o.yaw_deg},
              {"speed_px", flight.speed_px},
              {"sidelap", o.sidelap},
              {"frame_rate_hz", o.frame_rate_hz},
              {"wander_deg", o.wander_deg},
              {"jitter_deg", o.jitter_deg},
              {"position_wander_m", o.position_wander_m},
              {"drop_fraction", o.drop_fraction},
              {"gps_bias_m", o.gps_bias_m},
              {"gps_bias_e_m", flight.gps_bias_m.x()},
              {"gps_bias_n_m", flight.gps_bias_m.y()},
              {"gps_noise_m", o.gps_noise_m},
              {"attitude_noise_deg", o.attitude_noise_deg},
              {"attitude_bias_deg", o.attitude_bias_deg},
              {"control_points", o.control_count},
              {"control_noise_px", o.control_noise_px},
              {"seed", o.seed}};
}

std::string SortieText(const SimulationOptions& options) {
  return fmt::format(
      "# A simulated sortie; its truth is in truth/. Zeros mean: use the default.\n"
      "source {{\n  path: \"frames\"\n  frame_rate_hz: {:g}\n}}\n"
      "telemetry {{\n  path: \"frames/telemetry.csv\"\n}}\n"
      "sensor {{\n  psf_sigma_px: 0\n  fill_factor: 0\n}}\n",
      options.frame_rate_hz);
}

Status ParseFrameLine(const std::string& line, const std::string& where, Exposure* exposure) {
  std::vector<double> numbers;
  std::stringstream fields(line);
  std::string field;
  while (std::getline(fields, field, ',')) {
    try {
      numbers.push_back(std::stod(field));  // "00042.png" gives 42.
    } catch (const std::exception&) {
      return InvalidInput(where + ": '" + field + "' is not a number");
    }
  }
  if (numbers.size() != 25) return InvalidInput(fmt::format("{}: {} fields, expected 25", where, numbers.size()));
  exposure->index = static_cast<int>(numbers[0]);
  exposure->time_s = numbers[1];
  exposure->camera.position_m = {numbers[2], numbers[3]};
  exposure->camera.height_m = numbers[4];
  exposure->camera.map_scale = numbers[5];
  for (int i = 0; i < 9; ++i) exposure->camera.map_from_camera(i % 3, i / 3) = numbers[static_cast<std::size_t>(6 + i)];
  exposure->gain = numbers[21];
  exposure->offset = numbers[22];
  return {};
}

}  // namespace

std::string FrameName(int index) { return fmt::format("{:05d}.png", index); }

Status WriteRecords(const SimulationOptions& options, const Truth& truth, const Flight& flight, const fs::path& directory) {
  TREM_RETURN_IF_ERROR(WriteFileAtomically(directory / "frames" / "telemetry.csv", TelemetryCsv(options, flight)));
  TREM_RETURN_IF_ERROR(WriteFileAtomically(directory / "truth" / "frames.csv", FramesCsv(flight)));
  TREM_RETURN_IF_ERROR(WriteFileAtomically(directory / "truth" / "simulation.json", SimulationJson(options, truth, flight).dump(2) + "\n"));
  return WriteFileAtomically(directory / "sortie.textproto", SortieText(options));
}

Result<SimulationRecord> ReadSimulation(const fs::path& directory) {
  const fs::path json_path = directory / "truth" / "simulation.json";
  TREM_ASSIGN_OR_RETURN(const std::string json_text, ReadFile(json_path, kRecordBytesMax));
  SimulationRecord record;
  try {
    const Json json = Json::parse(json_text);
    record.options.width_px = json.at("width_px");
    record.options.height_px = json.at("height_px");
    record.options.gsd_m = json.at("sensor_gsd_m");
    record.options.cells_per_pixel = json.at("truth_cells_per_pixel");
    record.options.bit_depth = json.at("bit_depth");
    record.options.gps_bias_m = json.at("gps_bias_m");
    record.options.ground_elevation_m = json.at("ground_elevation_m");
    record.options.relief_m = json.value("relief_m", 0.0);
    record.flight.focal_px = json.at("focal_px");
    record.flight.gps_bias_m = {json.at("gps_bias_e_m").get<double>(), json.at("gps_bias_n_m").get<double>()};
  } catch (const nlohmann::json::exception& error) {
    return InvalidInput("'" + json_path.string() + "' is not a simulation's record: " + error.what());
  }
  TREM_RETURN_IF_ERROR(CheckSimulationOptions(record.options));
  const fs::path csv_path = directory / "truth" / "frames.csv";
  TREM_ASSIGN_OR_RETURN(const std::string csv_text, ReadFile(csv_path, kRecordBytesMax));
  if (csv_text.rfind(kFramesHeader, 0) != 0)
    return InvalidInput("'" + csv_path.string() + "' has another header than expected: " + kFramesHeader);
  std::stringstream lines(csv_text);
  std::string line;
  std::getline(lines, line);
  for (int number = 2; std::getline(lines, line); ++number) {
    Exposure exposure;
    TREM_RETURN_IF_ERROR(ParseFrameLine(line, fmt::format("{}:{}", csv_path.string(), number), &exposure));
    record.flight.exposures.push_back(exposure);
  }
  if (record.flight.exposures.empty()) return InvalidInput("'" + csv_path.string() + "' lists no frame");
  TREM_ASSIGN_OR_RETURN(record.truth, ReadTruth(directory / "truth" / "truth.tif"));
  if (record.options.relief_m > 0.0) {
    TREM_ASSIGN_OR_RETURN(record.truth.relief, ReadRelief(directory / "truth" / "dem.tif", record.options.ground_elevation_m));
    for (Exposure& exposure : record.flight.exposures) exposure.camera.relief = record.truth.relief.get();
  }
  return record;
}

}  // namespace trem
