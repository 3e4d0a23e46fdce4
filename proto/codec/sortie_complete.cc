// CompleteSortie: the ranges and defaults that job.proto documents.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

// Remembers the first value that is out of its range.
class RangeChecker {
 public:
  const Status& status() const { return status_; }

  void Number(const char* field, double value, double least, double most) {
    if (!(value >= least && value <= most)) Refuse(field, fmt::format("{}", value), fmt::format("{} to {}", least, most));
  }
  void Whole(const char* field, std::uint64_t value, std::uint64_t least, std::uint64_t most) {
    if (value < least || value > most) Refuse(field, fmt::format("{}", value), fmt::format("a whole number from {} to {}", least, most));
  }
  void Text(const char* field, const std::string& value, std::size_t length_max) {
    if (value.size() > length_max) Refuse(field, fmt::format("{} bytes long", value.size()), fmt::format("at most {}", length_max));
    if (std::any_of(value.begin(), value.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; })) {
      Refuse(field, "a text with control characters", "printable characters");
    }
    // Protobuf texts are UTF-8: what is not would be lost between the processes.
    try {
      (void)nlohmann::json(value).dump();
    } catch (const nlohmann::json::type_error&) {
      Refuse(field, "not valid UTF-8", "UTF-8 text");
    }
  }
  void Path(const char* field, const std::string& value) {
    constexpr std::size_t kPathBytesMax = 4096;
    Text(field, value, kPathBytesMax);
    // Specs are stored, shown and logged.
    const std::size_t scheme = value.find("://");
    if (scheme != std::string::npos && value.substr(scheme + 3, value.find('/', scheme + 3) - scheme - 3).find('@') != std::string::npos) {
      Refuse(field, "an address with a user name or password in it", "one without: credentials belong into the workers' environment");
    }
  }
  void Enum(const char* field, int value, bool is_known) {
    if (!is_known) Refuse(field, fmt::format("{}", value), "a value that job.proto names");
  }
  void Refuse(const std::string& field, const std::string& found, const std::string& expected) {
    if (status_.ok()) status_ = InvalidInput(fmt::format("{} is {}; expected {}", field, found, expected));
  }

 private:
  Status status_;
};

double OrDefault(double value, double default_value) { return value == 0.0 ? default_value : value; }
std::uint32_t OrDefault(std::uint32_t value, std::uint32_t default_value) { return value == 0 ? default_value : value; }

// The last part of the path, or the folder of a glob's pattern.
std::string NameOfSource(const std::string& source_path) {
  std::filesystem::path path(source_path);
  if (!path.has_filename()) path = path.parent_path();
  while (path.filename().string().find_first_of("*?[") != std::string::npos && path.has_parent_path()) path = path.parent_path();
  const std::string name = path.filename().string();
  return name.empty() ? source_path : name;
}

void CompleteSource(v1::Source* source, RangeChecker* check) {
  check->Path("source.path", source->path());
  source->set_frame_rate_hz(OrDefault(source->frame_rate_hz(), 25.0));
  check->Number("source.frame_rate_hz", source->frame_rate_hz(), 1e-3, 1e5);
  check->Enum("source.deinterlace", source->deinterlace(), v1::Deinterlace_IsValid(source->deinterlace()));
}

void CompleteTelemetry(v1::Telemetry* telemetry, RangeChecker* check) {
  check->Path("telemetry.path", telemetry->path());
  telemetry->set_position_sigma_m(OrDefault(telemetry->position_sigma_m(), 1.0));
  check->Number("telemetry.position_sigma_m", telemetry->position_sigma_m(), 1e-3, 1e5);
  telemetry->set_attitude_sigma_deg(OrDefault(telemetry->attitude_sigma_deg(), 0.1));
  check->Number("telemetry.attitude_sigma_deg", telemetry->attitude_sigma_deg(), 1e-4, 90.0);
  if (telemetry->has_ground_elevation_m()) {
    check->Number("telemetry.ground_elevation_m", telemetry->ground_elevation_m(), -1000.0, 10000.0);
  }
  check->Path("telemetry.dem_path", telemetry->dem_path());
  if (telemetry->has_ground_elevation_m() && !telemetry->dem_path().empty()) {
    check->Refuse("telemetry.dem_path", "set", "nothing beside telemetry.ground_elevation_m: the ground is one or the other");
  }
  if (telemetry->hfov_deg() != 0.0) check->Number("telemetry.hfov_deg", telemetry->hfov_deg(), 0.01, 179.0);
  if (telemetry->has_yaw_deg()) check->Number("telemetry.yaw_deg", telemetry->yaw_deg(), -360.0, 360.0);
  if (telemetry->has_pitch_deg()) check->Number("telemetry.pitch_deg", telemetry->pitch_deg(), -90.0, 90.0);
  if (telemetry->has_roll_deg()) check->Number("telemetry.roll_deg", telemetry->roll_deg(), -360.0, 360.0);
  if (telemetry->focal_sigma_percent() != 0.0) check->Number("telemetry.focal_sigma_percent", telemetry->focal_sigma_percent(), 1e-4, 50.0);
  if (telemetry->has_time_offset_s()) check->Number("telemetry.time_offset_s", telemetry->time_offset_s(), -86400.0, 86400.0);
}

void CompleteControl(v1::Control* control, RangeChecker* check) {
  check->Path("control.path", control->path());
  check->Text("control.held_out", control->held_out(), 1U << 16);
  if (control->path().empty() && !control->held_out().empty()) {
    check->Refuse("control.held_out", "set", "nothing without control.path: there are no points");
  }
  control->set_pixel_sigma_px(OrDefault(control->pixel_sigma_px(), 0.5));
  check->Number("control.pixel_sigma_px", control->pixel_sigma_px(), 1e-3, 1e3);
  control->set_survey_sigma_m(OrDefault(control->survey_sigma_m(), 0.1));
  check->Number("control.survey_sigma_m", control->survey_sigma_m(), 1e-4, 1e4);
}

void CompletePsf(v1::Sensor* sensor, RangeChecker* check) {
  check->Enum("sensor.psf_model", sensor->psf_model(), v1::PsfModel_IsValid(sensor->psf_model()));
  if (sensor->psf_model() == v1::PSF_AUTO) {
    sensor->set_psf_model(!sensor->psf_kernel_path().empty() ? v1::KERNEL_FILE : sensor->f_number() != 0.0 ? v1::OPTICS : v1::GAUSSIAN);
  }
  check->Path("sensor.psf_kernel_path", sensor->psf_kernel_path());
  if (sensor->psf_model() == v1::KERNEL_FILE) {
    if (sensor->psf_kernel_path().empty())
      check->Refuse("sensor.psf_kernel_path", "missing", "a file with the kernel, because psf_model is KERNEL_FILE");
    if (sensor->psf_sigma_px() != 0.0) {
      check->Refuse("sensor.psf_sigma_px", fmt::format("{}", sensor->psf_sigma_px()),
                    "nothing beside KERNEL_FILE: the kernel holds the whole blur");
    }
  } else if (!sensor->psf_kernel_path().empty()) {
    check->Refuse("sensor.psf_kernel_path", "set", "nothing unless psf_model is KERNEL_FILE or left out");
  }
  const bool optics = sensor->psf_model() == v1::OPTICS;
  const auto optical = [&](const char* field, double value, double least, double most) {
    if (optics || value != 0.0) check->Number(field, value, least, most);
  };
  optical("sensor.wavelength_um", sensor->wavelength_um(), 0.2, 20.0);
  optical("sensor.f_number", sensor->f_number(), 0.5, 100.0);
  optical("sensor.pixel_pitch_um", sensor->pixel_pitch_um(), 0.5, 200.0);
  if (optics && check->status().ok()) {
    check->Number("sensor.wavelength_um * f_number / pixel_pitch_um (the diffraction's width in pixels)",
                  sensor->wavelength_um() * sensor->f_number() / sensor->pixel_pitch_um(), 0.05, 4.0);
  }
  if (sensor->psf_sigma_px() != 0.0) check->Number("sensor.psf_sigma_px", sensor->psf_sigma_px(), 0.05, 3.0);
  check->Number("sensor.smear_px", sensor->smear_px(), 0.0, 10.0);
  check->Number("sensor.smear_direction_deg", sensor->smear_direction_deg(), -360.0, 360.0);
}

void CompleteSensor(v1::Sensor* sensor, RangeChecker* check) {
  CompletePsf(sensor, check);
  sensor->set_fill_factor(OrDefault(sensor->fill_factor(), 0.9));
  check->Number("sensor.fill_factor", sensor->fill_factor(), 0.05, 1.0);
  check->Number("sensor.noise_sigma", sensor->noise_sigma(), 0.0, 65535.0);
  check->Number("sensor.shot_noise", sensor->shot_noise(), 0.0, 65535.0);
  check->Path("sensor.bad_pixel_path", sensor->bad_pixel_path());
  check->Path("sensor.mask_path", sensor->mask_path());
  if (sensor->has_saturation_level()) check->Number("sensor.saturation_level", sensor->saturation_level(), -1e30, 1e30);
  check->Enum("sensor.detector_bias", sensor->detector_bias(), v1::Correction_IsValid(sensor->detector_bias()));
  check->Enum("sensor.vignetting", sensor->vignetting(), v1::Correction_IsValid(sensor->vignetting()));
}

void CompleteTre(v1::Tre* tre, RangeChecker* check) {
  tre->set_ratio(OrDefault(tre->ratio(), 3));
  check->Whole("tre.ratio", tre->ratio(), 2, 4);
  check->Enum("tre.registration", tre->registration(), v1::RegistrationMethod_IsValid(tre->registration()));
  check->Enum("tre.update", tre->update(), v1::UpdateScheme_IsValid(tre->update()));
  check->Enum("tre.structure", tre->structure(), v1::StructurePrior_IsValid(tre->structure()));
  tre->set_structure_weight(OrDefault(tre->structure_weight(), 1.0));
  check->Number("tre.structure_weight", tre->structure_weight(), 1e-6, 1e6);
  check->Whole("tre.iterations", tre->iterations(), 0, 1000);
  tre->set_landweber_window(OrDefault(tre->landweber_window(), 8));
  check->Whole("tre.landweber_window", tre->landweber_window(), 1, 64);
  if (tre->landweber_revisit() && tre->update() != v1::LANDWEBER) {
    check->Refuse("tre.landweber_revisit", "set", "nothing unless tre.update is LANDWEBER: no other scheme keeps frames");
  }
  check->Enum("tre.view_model", tre->view_model(), v1::ViewModel_IsValid(tre->view_model()));
  if (tre->dynamics_sigma_px() != 0.0) check->Number("tre.dynamics_sigma_px", tre->dynamics_sigma_px(), 1e-3, 1e3);
  check->Enum("tre.gain_offset", tre->gain_offset(), v1::GainOffset_IsValid(tre->gain_offset()));
  check->Enum("tre.mover_mask", tre->mover_mask(), v1::Correction_IsValid(tre->mover_mask()));
  if (tre->forgetting() != 0.0 && !(tre->forgetting() > 0.0 && tre->forgetting() <= 1.0)) {
    check->Refuse("tre.forgetting", fmt::format("{}", tre->forgetting()), "more than 0 and at most 1, or 0 for automatic");
  }
}

void CompleteWindows(v1::Windows* windows, RangeChecker* check) {
  windows->set_roi_px(OrDefault(windows->roi_px(), 201));
  check->Whole("windows.roi_px", windows->roi_px(), 41, 1024);
  windows->set_roi_overlap_px(OrDefault(windows->roi_overlap_px(), std::min<std::uint32_t>(40, windows->roi_px() / 5)));
  if (2 * std::uint64_t{windows->roi_overlap_px()} >= windows->roi_px()) {
    check->Refuse("windows.roi_overlap_px", fmt::format("{}", windows->roi_overlap_px()),
                  fmt::format("less than half of windows.roi_px ({})", windows->roi_px()));
  }
  windows->set_frames(OrDefault(windows->frames(), 96));
  check->Whole("windows.frames", windows->frames(), 2, 4096);
  windows->set_frame_overlap(OrDefault(windows->frame_overlap(), std::clamp<std::uint32_t>(windows->frames() / 4, 1, 24)));
  if (windows->frame_overlap() >= windows->frames()) {
    check->Refuse("windows.frame_overlap", fmt::format("{}", windows->frame_overlap()),
                  fmt::format("less than windows.frames ({})", windows->frames()));
  }
}

void CompleteBounds(const v1::Bounds& bounds, RangeChecker* check) {
  constexpr double kFar = 1e9;
  check->Number("mosaic.bounds.x_min", bounds.x_min(), -kFar, kFar);
  check->Number("mosaic.bounds.y_min", bounds.y_min(), -kFar, kFar);
  check->Number("mosaic.bounds.x_max", bounds.x_max(), -kFar, kFar);
  check->Number("mosaic.bounds.y_max", bounds.y_max(), -kFar, kFar);
  if (!(bounds.x_min() < bounds.x_max()) || !(bounds.y_min() < bounds.y_max())) {
    check->Refuse("mosaic.bounds", fmt::format("{},{},{},{}", bounds.x_min(), bounds.y_min(), bounds.x_max(), bounds.y_max()),
                  "x_min < x_max and y_min < y_max, in coordinates of the mosaic's CRS");
  }
}

void CompleteMosaic(v1::Mosaic* mosaic, RangeChecker* check) {
  if (mosaic->gsd() != 0.0) check->Number("mosaic.gsd", mosaic->gsd(), 1e-4, 1e4);
  check->Text("mosaic.crs", mosaic->crs(), 4096);
  mosaic->set_tile_px(OrDefault(mosaic->tile_px(), 512));
  if (mosaic->tile_px() < 64 || mosaic->tile_px() > 4096 || mosaic->tile_px() % 16 != 0) {
    check->Refuse("mosaic.tile_px", fmt::format("{}", mosaic->tile_px()), "a multiple of 16 from 64 to 4096");
  }
  check->Enum("mosaic.estimator", mosaic->estimator(), v1::MosaicEstimator_IsValid(mosaic->estimator()));
  if (mosaic->estimator() == v1::ESTIMATOR_AUTO) mosaic->set_estimator(v1::WEIGHTED_MEDIAN);
  check->Enum("mosaic.compression", mosaic->compression(), v1::Compression_IsValid(mosaic->compression()));
  if (mosaic->compression() == v1::COMPRESSION_AUTO) mosaic->set_compression(v1::DEFLATE);
  check->Enum("mosaic.pixel_type", mosaic->pixel_type(), v1::PixelType_IsValid(mosaic->pixel_type()));
  if (mosaic->pixel_type() == v1::PIXEL_TYPE_AUTO) mosaic->set_pixel_type(v1::FLOAT32);
  if (mosaic->has_bounds()) CompleteBounds(mosaic->bounds(), check);
  check->Text("mosaic.cutline_path", mosaic->cutline_path(), 4096);
}

}  // namespace

Status CompleteSortie(v1::Sortie* sortie) {
  if (sortie->source().path().empty()) {
    return InvalidInput("source.path is missing; expected a video file, a folder of images or a glob, as in: source { path: \"frames\" }");
  }
  RangeChecker check;
  check.Text("name", sortie->name(), 256);
  CompleteSource(sortie->mutable_source(), &check);
  CompleteTelemetry(sortie->mutable_telemetry(), &check);
  CompleteSensor(sortie->mutable_sensor(), &check);
  CompleteTre(sortie->mutable_tre(), &check);
  CompleteWindows(sortie->mutable_windows(), &check);
  CompleteMosaic(sortie->mutable_mosaic(), &check);
  CompleteControl(sortie->mutable_control(), &check);
  for (int k = 0; k < sortie->more_size(); ++k) {
    v1::Recording* const recording = sortie->mutable_more(k);
    const std::string where = fmt::format("more[{}]", k);
    if (recording->source().path().empty()) check.Refuse(where + ".source.path", "missing", "a video file, a folder of images or a glob");
    RangeChecker own;
    CompleteSource(recording->mutable_source(), &own);
    CompleteTelemetry(recording->mutable_telemetry(), &own);
    if (!own.status().ok()) return own.status().WithPrefix(where);
  }
  constexpr int kRecordingsMax = 1000;
  check.Whole("the number of recordings in more", static_cast<std::uint64_t>(sortie->more_size()), 0, kRecordingsMax);
  if (sortie->name().empty()) sortie->set_name(NameOfSource(sortie->source().path()));
  return check.status();
}

}  // namespace trem
