#include "worker/tasks/sensor_of.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>
#include <string>

#include "mosaic/base/file.h"
#include "worker/sortie/image_sequence_reader.h"

namespace trem {
namespace {

// Below half a grey level the quantisation of 8-bit sources dominates.
constexpr double kNoiseSigmaMin = 0.5;

Result<PsfKernel> ReadKernelRaster(const std::string& path) {
  TREM_ASSIGN_OR_RETURN(const ImageSize size, ReadImageSize(path));
  if (size.width_px > kKernelSideMax || size.height_px > kKernelSideMax) {
    return InvalidInput(path + ": the kernel has " + std::to_string(size.width_px) + " x " + std::to_string(size.height_px) +
                        " samples; expected at most 256 x 256");
  }
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadImageMetadata(path, "samples_per_pixel"));
  PsfKernel kernel;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), kernel.samples_per_pixel);
  if (text.empty() || error != std::errc() || end != text.data() + text.size()) {
    return InvalidInput(path + ": the metadata item samples_per_pixel is '" + text.substr(0, 40) +
                        "'; expected a number: samples of the kernel per sensor pixel (gdal_edit.py -mo samples_per_pixel=4)");
  }
  TREM_ASSIGN_OR_RETURN(const GreyImage image, ReadGreyImage(path));
  kernel.width = size.width_px;
  kernel.height = size.height_px;
  kernel.values.assign(image.pixels.pixels().begin(), image.pixels.pixels().end());
  TREM_RETURN_IF_ERROR(CheckPsfKernel(kernel, path));
  return kernel;
}

}  // namespace

PsfParameters PsfParametersOf(const v1::Sensor& sensor, const v1::SensorManifest& found) {
  PsfParameters psf;
  if (sensor.fill_factor() > 0.0) psf.fill_factor = sensor.fill_factor();
  psf.smear_px = sensor.smear_px();
  psf.smear_direction_rad = sensor.smear_direction_deg() * std::numbers::pi / 180.0;
  switch (sensor.psf_model()) {
    case v1::OPTICS:
      psf.model = PsfModel::kOptics;
      psf.q = OpticsQ(sensor);
      psf.sigma_px = sensor.psf_sigma_px();
      break;
    case v1::KERNEL_FILE:
      psf.model = PsfModel::kKernelFile;
      psf.kernel.width = static_cast<int>(found.psf_kernel().width());
      psf.kernel.height = static_cast<int>(found.psf_kernel().height());
      psf.kernel.samples_per_pixel = found.psf_kernel().samples_per_pixel();
      psf.kernel.values.assign(found.psf_kernel().values().begin(), found.psf_kernel().values().end());
      break;
    default:
      if (sensor.psf_sigma_px() > 0.0) {
        psf.sigma_px = sensor.psf_sigma_px();
      } else if (found.psf_sigma_px() > 0.0) {
        psf.sigma_px = found.psf_sigma_px();
      }
  }
  return psf;
}

double OpticsQ(const v1::Sensor& sensor) {
  return sensor.pixel_pitch_um() > 0.0 ? sensor.wavelength_um() * sensor.f_number() / sensor.pixel_pitch_um() : 0.0;
}

NoiseModel NoiseModelOf(const v1::Sensor& sensor, const v1::SortieManifest& manifest) {
  const double scale = manifest.grey_scale();
  const double photons = sensor.shot_noise() * std::max(manifest.sensor().grey_median(), 0.0) / (scale * scale);
  NoiseModel model;
  // (read^2 + shot * I_source) / scale^2 with I_source = scale * (internal grey levels above black).
  model.shot = sensor.shot_noise() / scale;
  if (sensor.noise_sigma() > 0.0) {
    model.read_variance = std::pow(sensor.noise_sigma() / scale, 2);
    model.typical_variance = model.read_variance + photons;
  } else {
    model.typical_variance = std::pow(std::max(manifest.noise_sigma(), kNoiseSigmaMin), 2);
    model.read_variance = std::max(model.typical_variance - photons, 0.01 * model.typical_variance);
  }
  return model;
}

Result<PsfKernel> ReadPsfKernel(const std::string& path) {
  if (HasImageExtension(path)) return ReadKernelRaster(path);
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kKernelFileBytesMax));
  return ParsePsfKernel(text, path);
}

}  // namespace trem
