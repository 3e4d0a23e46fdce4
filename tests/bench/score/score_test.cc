// Goal: the scorer's figures are right, because every claim about quality rests on them. Method: mosaics with known faults (a shift, a
// stretch, a hole, a gain and offset, no enhancement at all) are made from the truth of a small simulation, and the scorer must give the
// faults back.
#include "tests/bench/score/score.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <optional>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/geotiff.h"
#include "tests/bench/score/patch_shifts.h"
#include "tests/bench/score/rasters.h"
#include "tests/support/paths.h"
#include "worker/simulate/simulation.h"

namespace trem::score {
namespace {

using ::testing::HasSubstr;
using trem::testing::TempDir;

class Scorer : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<TempDir>();
    SimulationOptions options;
    options.terrain_width_cells = 900;
    options.terrain_height_cells = 560;
    options.width_px = 150;
    options.height_px = 120;
    options.frame_count = 40;
    ASSERT_TRUE(Simulate(options, Folder(), {}).ok());
    Result<SimulationRecord> record = ReadSimulation(Folder());
    ASSERT_TRUE(record.ok());
    record_ = std::make_unique<SimulationRecord>(std::move(record).value());
    reference_ = std::make_unique<Reference>(*record_);
  }
  static void TearDownTestSuite() {
    reference_.reset();
    record_.reset();
    folder_.reset();
  }

  static std::filesystem::path Folder() { return *folder_ / "sortie"; }

  // A grid over the truth that is not aligned with it, a little coarser.
  static MosaicGrid Grid() {
    MosaicGrid grid = record_->truth.grid;
    grid.gsd = 0.103;
    grid.origin_x += 1.234;
    grid.origin_y -= 0.777;
    grid.width = 850;
    grid.height = 520;
    return grid;
  }

  // The truth moved by `shift`; nothing where that would show ground outside of it.
  static double Moved(const Eigen::Vector2d& x, const Eigen::Vector2d& shift) {
    const Eigen::Vector2d place = x - shift;
    return reference_->Covers(place) ? reference_->At(place) : std::numeric_limits<double>::quiet_NaN();
  }

  // The score of the mosaic that has value(x_in_map) everywhere.
  static Result<Score> ScoreOf(const std::function<double(const Eigen::Vector2d&)>& value) {
    const MosaicGrid grid = Grid();
    Image<float> grey(grid.width, grid.height);
    for (int y = 0; y < grid.height; ++y) {
      for (int x = 0; x < grid.width; ++x) grey.at(x, y) = static_cast<float>(value(grid.WorldFromPixel({x * 1.0, y * 1.0})));
    }
    return ScoreOf(std::move(grey), grid);
  }
  static Result<Score> ScoreOf(Image<float> grey, const MosaicGrid& grid) {
    const std::filesystem::path path = *folder_ / "mosaic.tif";
    std::filesystem::remove(path);
    const Status written = WriteFloatRaster(path, {{{"mosaic", std::move(grey)}}, grid, std::numeric_limits<double>::quiet_NaN(), {}});
    if (!written.ok()) return written;
    return ScoreMosaic(Folder(), path, {}, nullptr);
  }

  static std::unique_ptr<TempDir> folder_;
  static std::unique_ptr<SimulationRecord> record_;
  static std::unique_ptr<Reference> reference_;
};

std::unique_ptr<TempDir> Scorer::folder_;
std::unique_ptr<SimulationRecord> Scorer::record_;
std::unique_ptr<Reference> Scorer::reference_;

TEST_F(Scorer, FindsAPerfectMosaicPerfectWhateverItsGainAndOffset) {
  const Result<Score> score = ScoreOf([](const Eigen::Vector2d& x) { return 0.5 * reference_->At(x) + 31.0; });
  ASSERT_TRUE(score.ok()) << score.status().message();
  EXPECT_GT(score->coverage, 0.999);
  EXPECT_LT(score->absolute_error_m, 0.001);
  EXPECT_GT(score->patch_count, 10);
  EXPECT_EQ(score->matched_count, score->patch_count);
  EXPECT_LT(score->distortion_p95_px, 0.01);
  EXPECT_GT(score->mosaic.psnr_db, 55.0);
  EXPECT_GT(score->mosaic.ssim, 0.999);
  EXPECT_LT(score->bicubic.psnr_db, 40.0);
  EXPECT_NEAR(score->gps_bias_m, 1.0, 1e-5);
}

TEST_F(Scorer, MeasuresAShiftOfTheWholeMosaicAndDoesNotCountItAsDistortion) {
  const Eigen::Vector2d shift(0.83, -1.41);
  const Result<Score> score = ScoreOf([&](const Eigen::Vector2d& x) { return Moved(x, shift); });
  ASSERT_TRUE(score.ok()) << score.status().message();
  EXPECT_NEAR(score->shift_e_m, shift.x(), 0.003);
  EXPECT_NEAR(score->shift_n_m, shift.y(), 0.003);
  EXPECT_NEAR(score->absolute_error_m, shift.norm(), 0.003);
  EXPECT_LT(score->distortion_p95_px, 0.02);
  EXPECT_GT(score->mosaic.psnr_db, 45.0);
}

TEST_F(Scorer, GivesBackTheWarpOfEveryPatchAndItsQuantiles) {
  // Content stretched by 0.4% to east and sheared a little: mosaic position - true position grows with the distance from the centre.
  const Eigen::Vector2d centre = Grid().WorldFromPixel({425.0, 260.0});
  Eigen::Matrix2d stretch;
  stretch << 0.004, 0.001, 0.0, 0.0;
  const Eigen::Matrix2d true_from_mosaic = (Eigen::Matrix2d::Identity() + stretch).inverse();
  const auto value = [&](const Eigen::Vector2d& x) {
    const Eigen::Vector2d place = centre + true_from_mosaic * (x - centre);
    return reference_->At(place);
  };
  const MosaicGrid grid = Grid();
  Image<float> mosaic(grid.width, grid.height);
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) mosaic.at(x, y) = static_cast<float>(value(grid.WorldFromPixel({x * 1.0, y * 1.0})));
  }
  MosaicGrid larger = grid;  // By 20 px on every side.
  larger.origin_x -= 20 * grid.gsd;
  larger.origin_y += 20 * grid.gsd;
  larger.width += 40;
  larger.height += 40;
  const std::vector<PatchShift> shifts = MeasurePatchShifts(mosaic, reference_->OnGrid(larger, {0.0, 0.0}), {0.0, 0.0}, {120, 18, 20, 2.0});
  ASSERT_GT(shifts.size(), 20U);
  for (const PatchShift& shift : shifts) {
    ASSERT_TRUE(shift.matched);
    const Eigen::Vector2d x = grid.WorldFromPixel(shift.centre_px);
    const Eigen::Vector2d expected_m = x - (centre + true_from_mosaic * (x - centre));
    // Texture is not spread evenly over a patch, which stretches by 0.5 px inside: hence the tolerance.
    EXPECT_NEAR(shift.shift_px.x() * grid.gsd, expected_m.x(), 0.025);
    EXPECT_NEAR(shift.shift_px.y() * grid.gsd, -expected_m.y(), 0.01);
  }
  const Result<Score> score = ScoreOf(std::move(mosaic), grid);
  ASSERT_TRUE(score.ok()) << score.status().message();
  // The stretch is symmetric about the centre, so the quantiles are those of |0.4% of a distance uniform in [0, half the patches' span]|.
  const double span_px = 0.004 * (850.0 - 163.0) * 0.103 / 0.3;
  EXPECT_NEAR(score->distortion_median_px, 0.25 * span_px, 0.06);
  EXPECT_NEAR(score->distortion_p95_px, 0.475 * span_px, 0.07);
  EXPECT_LT(score->absolute_error_m, 0.1);
}

TEST_F(Scorer, CountsAHoleInTheMosaicAsMissingCoverage) {
  const double middle = 0.5 * (record_->truth.grid.origin_x + record_->truth.grid.WorldFromPixel({899.0, 0.0}).x());
  const Result<Score> score =
      ScoreOf([&](const Eigen::Vector2d& x) { return x.x() < middle ? reference_->At(x) : std::numeric_limits<double>::quiet_NaN(); });
  ASSERT_TRUE(score.ok()) << score.status().message();
  // The line is centred in the truth, so half of what was seen is left.
  EXPECT_NEAR(score->coverage, 0.5, 0.01);
}

TEST_F(Scorer, GivesAMosaicOfSingleBicubicFramesNoGain) {
  const MosaicGrid grid = Grid();
  Result<Image<float>> bicubic = BicubicFrames(Folder(), *record_, grid, {0.0, 0.0});
  ASSERT_TRUE(bicubic.ok()) << bicubic.status().message();
  const Result<Score> score = ScoreOf(std::move(bicubic).value(), grid);
  ASSERT_TRUE(score.ok()) << score.status().message();
  EXPECT_NEAR(score->gain_db, 0.0, 0.05);
  EXPECT_LT(score->absolute_error_m, 0.01);
  EXPECT_LT(score->distortion_p95_px, 0.1);
  EXPECT_GT(score->coverage, 0.99);
}

TEST_F(Scorer, CountsPatchesThatMatchNowhereAgainstTheMosaic) {
  // A quarter of the mosaic shows another place.
  const MosaicGrid grid = Grid();
  const Eigen::Vector2d corner = grid.WorldFromPixel({425.0, 0.0});
  const Result<Score> score = ScoreOf([&](const Eigen::Vector2d& x) {
    const Eigen::Vector2d elsewhere = x - Eigen::Vector2d(30.0, 11.0);
    return reference_->At(x.x() > corner.x() ? elsewhere : x);
  });
  ASSERT_TRUE(score.ok()) << score.status().message();
  EXPECT_LT(score->matched_count, score->patch_count);
  EXPECT_NEAR(score->distortion_p95_px, 6.0, 0.5);
}

TEST_F(Scorer, RefusesMosaicsItCannotCompare) {
  MosaicGrid grid = Grid();
  const Image<float> grey(grid.width, grid.height, 7.0F);
  const Result<Score> flat = ScoreOf(grey, grid);
  EXPECT_EQ(flat.status().code(), StatusCode::kFailed);
  EXPECT_THAT(flat.status().message(), HasSubstr("no patch of the mosaic"));
  grid.crs_wkt = *CrsWkt("EPSG:32631");
  const Result<Score> elsewhere = ScoreOf(grey, grid);
  EXPECT_EQ(elsewhere.status().code(), StatusCode::kInvalidInput);
  EXPECT_THAT(elsewhere.status().message(), HasSubstr("UTM zone 31N"));
  EXPECT_EQ(ScoreMosaic(Folder(), *folder_ / "absent.tif", {}, nullptr).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(ScoreMosaic(*folder_ / "absent", *folder_ / "mosaic.tif", {}, nullptr).status().code(), StatusCode::kNotFound);
}

TEST_F(Scorer, DrawsAPictureOfTheComparedPlaces) {
  const MosaicGrid grid = Grid();
  const Compared compared{reference_->OnGrid(grid, {0, 0}), reference_->OnGrid(grid, {0.3, 0}), reference_->OnGrid(grid, {0, 0})};
  const Status drawn = WritePicture(compared, *folder_ / "picture.png");
  ASSERT_TRUE(drawn.ok()) << drawn.message();
  EXPECT_GT(std::filesystem::file_size(*folder_ / "picture.png"), 10000U);
  EXPECT_EQ(WritePicture(compared, *folder_ / "no" / "folder.png").code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace trem::score
