#include "tests/bench/score/score.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/bench/score/fidelity.h"
#include "tests/bench/score/patch_shifts.h"
#include "tests/bench/score/rasters.h"

namespace trem::score {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr double kPatchRadiusPx = 6.0;  // Sensor pixels.

// Means of `factor` x `factor` pixels; NaN when one is.
Image<float> Shrink(const Image<float>& image, int factor) {
  Image<float> small(image.width() / factor, image.height() / factor);
  for (int y = 0; y < small.height(); ++y) {
    for (int x = 0; x < small.width(); ++x) {
      double sum = 0.0;
      for (int j = 0; j < factor; ++j) {
        for (int i = 0; i < factor; ++i) sum += image.at(x * factor + i, y * factor + j);
      }
      small.at(x, y) = static_cast<float>(sum / (factor * factor));
    }
  }
  return small;
}

// `grid` with `margin` more pixels on every side.
MosaicGrid Enlarged(MosaicGrid grid, int margin) {
  grid.origin_x -= margin * grid.gsd;
  grid.origin_y += margin * grid.gsd;
  grid.width += 2 * margin;
  grid.height += 2 * margin;
  return grid;
}

Image<float> Cropped(const Image<float>& image, int width, int height) {
  Image<float> part(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(image.row(y), width, part.row(y));
  return part;
}

// Shifts of all textured patches, and the one shift of the whole mosaic in mosaic pixels: first on shrunken images over the whole search
// range, then at full size.
Result<std::vector<PatchShift>> MeasureShifts(const MosaicImage& mosaic, const Reference& reference, const SimulationRecord& record,
                                              const ScoreOptions& options, Eigen::Vector2d* global_px) {
  const double ratio = record.options.gsd_m / mosaic.grid.gsd;  // Mosaic pixels a sensor pixel.
  const double search_m =
      options.search_m > 0.0 ? options.search_m : std::max(12.0 * record.options.gsd_m, 2.0 * record.flight.gps_bias_m.norm() + 2.0);
  const int factor = std::max(1, static_cast<int>(std::lround(ratio)));
  PatchOptions coarse;
  coarse.patch_px = options.patch_px;
  coarse.radius_px = std::max(4, static_cast<int>(std::ceil(search_m / (mosaic.grid.gsd * factor))));
  PatchOptions fine;
  fine.patch_px = static_cast<int>(std::lround(options.patch_px * ratio));
  fine.radius_px = static_cast<int>(std::ceil(kPatchRadiusPx * ratio));
  // Gauss-Newton may add 2 px to the coarse shift.
  coarse.margin_px = coarse.radius_px + 2 + (fine.radius_px + factor - 1) / factor + 1;
  fine.margin_px = coarse.margin_px * factor;
  // The mosaic is cut to whole blocks so that both shrink alike.
  const int width = mosaic.grid.width / factor * factor;
  const int height = mosaic.grid.height / factor * factor;
  const Image<float> truth = reference.OnGrid(Enlarged(mosaic.grid, fine.margin_px), {0.0, 0.0});
  const Image<float> small_truth = Shrink(Cropped(truth, width + 2 * fine.margin_px, height + 2 * fine.margin_px), factor);
  const std::string advice = "either the mosaic is wrong, or further off than --search-m, or smaller than a patch (--patch-px)";
  const auto start = MedianShift(MeasurePatchShifts(Shrink(mosaic.grey, factor), small_truth, {0.0, 0.0}, coarse), 1);
  if (!start) return Failed("no patch of the mosaic can be found in the truth at sensor resolution: " + advice);
  std::vector<PatchShift> shifts = MeasurePatchShifts(mosaic.grey, truth, *start * factor, fine);
  const auto refined = MedianShift(shifts, 1);
  if (!refined) return Failed("no patch of the mosaic can be found in the truth at full resolution: " + advice);
  *global_px = *refined;
  return shifts;
}

void Summarise(const std::vector<PatchShift>& shifts, const Eigen::Vector2d& global_px, double ratio, Score* score) {
  std::vector<double> distances;
  for (const PatchShift& shift : shifts) {
    score->matched_count += shift.matched ? 1 : 0;
    distances.push_back(shift.matched ? (shift.shift_px - global_px).norm() / ratio : kPatchRadiusPx);
  }
  score->patch_count = static_cast<int>(distances.size());
  score->distortion_median_px = Quantile(distances, 0.5);
  score->distortion_p95_px = Quantile(distances, 0.95);
}

}  // namespace

Result<Score> ScoreMosaic(const std::filesystem::path& simulation, const std::filesystem::path& mosaic_path, const ScoreOptions& options,
                          Compared* compared) {
  TREM_ASSIGN_OR_RETURN(const SimulationRecord record, ReadSimulation(simulation));
  TREM_ASSIGN_OR_RETURN(const MosaicImage mosaic, ReadMosaic(mosaic_path, record.truth.grid.crs_wkt));
  const Reference reference(record);
  Score score;
  Eigen::Vector2d global_px;
  TREM_ASSIGN_OR_RETURN(const std::vector<PatchShift> shifts, MeasureShifts(mosaic, reference, record, options, &global_px));
  Summarise(shifts, global_px, record.options.gsd_m / mosaic.grid.gsd, &score);
  const Eigen::Vector2d shift_m(global_px.x() * mosaic.grid.gsd, -global_px.y() * mosaic.grid.gsd);
  score.shift_e_m = shift_m.x();
  score.shift_n_m = shift_m.y();
  score.absolute_error_m = shift_m.norm();
  score.gps_bias_e_m = record.flight.gps_bias_m.x();
  score.gps_bias_n_m = record.flight.gps_bias_m.y();
  score.gps_bias_m = record.flight.gps_bias_m.norm();
  score.sensor_gsd_m = record.options.gsd_m;
  score.mosaic_gsd_m = mosaic.grid.gsd;
  score.coverage = Coverage(record, mosaic, shift_m);

  Compared images;
  images.truth = reference.OnGrid(mosaic.grid, shift_m);
  TREM_ASSIGN_OR_RETURN(images.bicubic, BicubicFrames(simulation, record, mosaic.grid, shift_m));
  images.mosaic = mosaic.grey;
  for (int y = 0; y < mosaic.grid.height; ++y) {
    for (int x = 0; x < mosaic.grid.width; ++x) {
      const Eigen::Vector2d place = mosaic.grid.WorldFromPixel({x * 1.0, y * 1.0}) - shift_m;
      const bool both = std::isfinite(images.mosaic.at(x, y)) && std::isfinite(images.bicubic.at(x, y)) && reference.Covers(place);
      if (!both) images.truth.at(x, y) = images.bicubic.at(x, y) = images.mosaic.at(x, y) = kNone;
      score.pixel_count += both ? 1 : 0;
    }
  }
  score.mosaic = FitAndCompare(images.truth, &images.mosaic);
  score.evenness =
      MeasureEvenness(images.truth, images.mosaic, static_cast<int>(std::lround(8.0 * record.options.gsd_m / mosaic.grid.gsd)));
  score.bicubic = FitAndCompare(images.truth, &images.bicubic);
  score.gain_db = score.mosaic.psnr_db - score.bicubic.psnr_db;
  if (compared != nullptr) *compared = std::move(images);
  return score;
}

std::string ToTable(const Score& s) {
  return fmt::format(
      "coverage                      {:8.4f}\n"
      "absolute position error       {:8.3f} m       east {:+.3f}, north {:+.3f}; simulated GPS bias {:.3f} m (east {:+.3f}, north "
      "{:+.3f})\n"
      "relative distortion, median   {:8.3f} px      sensor pixels; {} textured patches, {} matched\n"
      "relative distortion, 95%      {:8.3f} px\n"
      "PSNR / SSIM, mosaic           {:8.2f} dB      {:.4f}\n"
      "PSNR / SSIM, bicubic frame    {:8.2f} dB      {:.4f}\n"
      "gain over the bicubic frame   {:+8.2f} dB      on {} pixels of {:.3f} m (sensor {:.3f} m)\n"
      "mean error of a place         {:8.2f} levels  rms over blocks of 8 sensor px; 95% of the steps between neighbours {:.2f} levels\n",
      s.coverage, s.absolute_error_m, s.shift_e_m, s.shift_n_m, s.gps_bias_m, s.gps_bias_e_m, s.gps_bias_n_m, s.distortion_median_px,
      s.patch_count, s.matched_count, s.distortion_p95_px, s.mosaic.psnr_db, s.mosaic.ssim, s.bicubic.psnr_db, s.bicubic.ssim, s.gain_db,
      s.pixel_count, s.mosaic_gsd_m, s.sensor_gsd_m, s.evenness.level_rms, s.evenness.step_p95);
}

std::string ToJson(const Score& s, const Substitution* substitution) {
  nlohmann::ordered_json json = {{"coverage", s.coverage},
                                 {"absolute_error_m", s.absolute_error_m},
                                 {"shift_e_m", s.shift_e_m},
                                 {"shift_n_m", s.shift_n_m},
                                 {"gps_bias_m", s.gps_bias_m},
                                 {"gps_bias_e_m", s.gps_bias_e_m},
                                 {"gps_bias_n_m", s.gps_bias_n_m},
                                 {"distortion_median_px", s.distortion_median_px},
                                 {"distortion_p95_px", s.distortion_p95_px},
                                 {"patches_textured", s.patch_count},
                                 {"patches_matched", s.matched_count},
                                 {"psnr_db", s.mosaic.psnr_db},
                                 {"ssim", s.mosaic.ssim},
                                 {"bicubic_psnr_db", s.bicubic.psnr_db},
                                 {"bicubic_ssim", s.bicubic.ssim},
                                 {"gain_db", s.gain_db},
                                 {"level_rms", s.evenness.level_rms},
                                 {"seam_p95", s.evenness.step_p95},
                                 {"pixels", s.pixel_count},
                                 {"sensor_gsd_m", s.sensor_gsd_m},
                                 {"mosaic_gsd_m", s.mosaic_gsd_m}};
  if (substitution != nullptr) {
    const Placement& placement = substitution->placement;
    json["truly_placed_psnr_db"] = substitution->truly_placed.psnr_db;
    json["truly_placed_ssim"] = substitution->truly_placed.ssim;
    json["placement_loss_db"] = substitution->truly_placed.psnr_db - s.mosaic.psnr_db;
    json["scenes"] = placement.scene_count;
    json["scene_error_m"] = placement.error_m;
    json["scene_relative_error_m"] = placement.relative_error_m;
    json["scene_sigma_m"] = placement.sigma_m;
    json["within_one_sigma"] = placement.within_one_sigma;
    json["within_two_sigma"] = placement.within_two_sigma;
    for (const Substitute& other : substitution->others) json["substitutes"][other.what] = other.fidelity.psnr_db;
  }
  return json.dump(2);
}

}  // namespace trem::score
