#include "tests/bench/score/substitution.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <utility>

#include "mosaic/composite/warp.h"
#include "mosaic/geometry/footprint.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "tests/bench/score/kept_run.h"
#include "tests/bench/score/rasters.h"

namespace trem::score {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
// Cells of a scene nearer to its border than this many do not count when it is looked at by itself.
constexpr float kBorderCells = 24.0F;

CompositeScene TrulyPlaced(const ScenePlacement& placement) {
  CompositeScene scene = placement.aligned;
  scene.world_from_scene = placement.true_world_from_scene;
  scene.shifts = placement.true_shifts;
  return scene;
}

CompositeScene TrulyBalanced(CompositeScene scene, const ScenePlacement& placement) {
  scene.gain = placement.true_gain;
  scene.offset = placement.true_offset;
  return scene;
}

class Substituter {
 public:
  Substituter(const KeptRun& run, const SimulationRecord& record, std::vector<ScenePlacement> placements, MosaicGrid grid)
      : run_(run), placements_(std::move(placements)), grid_(std::move(grid)), reference_(record), truth_(reference_.OnGrid(grid_, {0, 0})) {
    for (int y = 0; y < grid_.height; ++y) {
      for (int x = 0; x < grid_.width; ++x) {
        if (!reference_.Covers(grid_.WorldFromPixel({x * 1.0, y * 1.0}))) truth_.at(x, y) = kNone;
      }
    }
  }

  template <typename Change>
  Result<Fidelity> With(const Change& change, const CompositeOptions& options = {}) const {
    TREM_ASSIGN_OR_RETURN(Image<float> mosaic, ComposeAgain(run_, placements_, change, options));
    return FitAndCompare(truth_, &mosaic);
  }

  // The scenes one by one, truly placed and away from their borders: errors of all of them together.
  Result<double> SingleScenesPsnr(double information_min) const {
    double squares = 0.0, count = 0.0;
    for (const ScenePlacement& placement : placements_) {
      TREM_ASSIGN_OR_RETURN(const std::filesystem::path path, run_.store.Locate(placement.raster));
      TREM_ASSIGN_OR_RETURN(const SceneRaster raster, ReadSceneRaster(path, 1LL << 24));
      for (int y = 12; y + 12 < raster.intensity.height(); ++y) {
        for (int x = 12; x + 12 < raster.intensity.width(); ++x) {
          if (!(raster.information.at(x, y) > information_min) || !Inside(raster.information, x, y)) continue;
          const Roi& roi = placement.aligned.raster_in_scene;
          const Eigen::Vector2d place =
              placement.true_world_from_scene * Unshifted(placement.true_shifts, Eigen::Vector2d(roi.x0 + x, roi.y0 + y));
          if (!reference_.Covers(place)) continue;
          const double error = placement.true_gain * raster.intensity.at(x, y) + placement.true_offset - reference_.At(place);
          squares += error * error;
          count += 1.0;
        }
      }
    }
    return 10.0 * std::log10(255.0 * 255.0 * count / squares);
  }

 private:
  static bool Inside(const Image<float>& information, int x, int y) {
    const auto reach = static_cast<int>(kBorderCells);
    for (const int dx : {-reach, 0, reach}) {
      for (const int dy : {-reach, 0, reach}) {
        if (x + dx < 0 || y + dy < 0 || x + dx >= information.width() || y + dy >= information.height()) return false;
        if (!(information.at(x + dx, y + dy) > 0.0F)) return false;
      }
    }
    return true;
  }

  const KeptRun& run_;
  std::vector<ScenePlacement> placements_;
  MosaicGrid grid_;
  Reference reference_;
  Image<float> truth_;
};

Placement PlacementOf(const std::vector<ScenePlacement>& placements) {
  Placement result;
  result.scene_count = placements.size();
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  const double axes = 2.0 * static_cast<double>(placements.size());
  for (const ScenePlacement& p : placements) mean += p.error_m / static_cast<double>(placements.size());
  for (const ScenePlacement& p : placements) {
    result.error_m += p.error_m.squaredNorm() / axes;
    result.relative_error_m += (p.error_m - mean).squaredNorm() / axes;
    result.sigma_m += 2.0 * p.aligned.position_sigma * p.aligned.position_sigma / axes;
    for (int k = 0; k < 2; ++k) {
      result.within_one_sigma += std::abs(p.error_m[k]) <= p.aligned.position_sigma ? 1.0 / axes : 0.0;
      result.within_two_sigma += std::abs(p.error_m[k]) <= 2.0 * p.aligned.position_sigma ? 1.0 / axes : 0.0;
    }
  }
  result.error_m = std::sqrt(result.error_m);
  result.relative_error_m = std::sqrt(result.relative_error_m);
  result.sigma_m = std::sqrt(result.sigma_m);
  return result;
}

}  // namespace

Result<Substitution> CompareSubstitutes(const std::filesystem::path& simulation, const std::filesystem::path& work, bool all) {
  TREM_ASSIGN_OR_RETURN(const SimulationRecord record, ReadSimulation(simulation));
  TREM_ASSIGN_OR_RETURN(const KeptRun run, ReadKeptRun(work));
  TREM_ASSIGN_OR_RETURN(const std::vector<ScenePlacement> placements, PlaceTruly(run, record));
  TREM_ASSIGN_OR_RETURN(const MosaicGrid grid, FromProto(run.alignment.grid()));
  const Substituter with(run, record, placements, grid);
  Substitution result;
  result.placement = PlacementOf(placements);
  TREM_ASSIGN_OR_RETURN(result.truly_placed, with.With(TrulyPlaced));
  if (!all) return result;
  Substitute substitute;
  substitute.what = "true places, gains and offsets";
  TREM_ASSIGN_OR_RETURN(substitute.fidelity, with.With([](const ScenePlacement& p) { return TrulyBalanced(TrulyPlaced(p), p); }));
  result.others.push_back(substitute);
  substitute.what = "the same, mean instead of median";
  CompositeOptions mean;
  mean.median.blend = 0.499;
  TREM_ASSIGN_OR_RETURN(substitute.fidelity, with.With([](const ScenePlacement& p) { return TrulyBalanced(TrulyPlaced(p), p); }, mean));
  result.others.push_back(substitute);
  for (const double information : {0.0, 2.0, 5.0, 10.0}) {
    substitute.what = fmt::format("scenes one by one, truly placed, information > {}", information);
    TREM_ASSIGN_OR_RETURN(substitute.fidelity.psnr_db, with.SingleScenesPsnr(information));
    substitute.fidelity.ssim = 0.0;
    result.others.push_back(substitute);
  }
  return result;
}

std::string ToTable(const Substitution& s) {
  std::string text = fmt::format(
      "PSNR / SSIM, truly placed     {:8.2f} dB      {:.4f}     the median of the same scenes placed with the true transforms\n"
      "error of {:4} scenes          {:8.3f} m       without their mean {:.3f} m; stated {:.3f} m; within 1 / 2 sigma {:.3f} / {:.3f}\n",
      s.truly_placed.psnr_db, s.truly_placed.ssim, s.placement.scene_count, s.placement.error_m, s.placement.relative_error_m,
      s.placement.sigma_m, s.placement.within_one_sigma, s.placement.within_two_sigma);
  for (const Substitute& other : s.others) text += fmt::format("  {:50} {:8.2f} dB      {:.4f}\n", other.what, other.fidelity.psnr_db, other.fidelity.ssim);
  return text;
}

}  // namespace trem::score
