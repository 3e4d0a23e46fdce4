// Goal: the width of the PSF and the noise are found from the frames' spectrum within the stated error, whatever the noise, bad pixels or
// the size of the ground's objects, and an estimate that the frames do not support is not made. Method: frames of leaves (discs that hide
// one another, the model whose spectrum is that of natural pictures) and of a photograph when it is there, rendered by an independent
// sensor with known widths, fixed seeds; frames without texture, of noise, of periodic structure.
#include "worker/tre/psf_estimate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>

#include "mosaic/base/rng.h"
#include "tests/support/leaf_truth.h"
#include "tests/support/paths.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/truth_picture.h"

namespace trem {
namespace {

testing::SequenceOptions Options(double psf_sigma_px, double noise_sigma) {
  testing::SequenceOptions options;
  options.frame_count = 4;
  options.roi_px = 161;
  options.psf_sigma_px = psf_sigma_px;
  options.noise_sigma = noise_sigma;
  options.speed_px = 6.0;
  return options;
}

FrameSpectrum SpectrumOf(const testing::RenderedSequence& sequence) {
  FrameSpectrum spectrum;
  for (const FrameInput& frame : sequence.frames) spectrum.Add(frame.pixels);
  return spectrum;
}

void Print(const char* what, double truth, double noise, const PsfEstimate& estimate) {
  std::printf("%s, true %.2f px, noise %.1f: %.3f +- %.3f px, noise %.2f, exponent %.2f, misfit %.2f %s\n", what, truth, noise,
              estimate.sigma_px, estimate.error_px, estimate.noise_sigma, estimate.scene_exponent, estimate.misfit, estimate.doubt.c_str());
}

class PsfEstimateOf : public ::testing::TestWithParam<double> {};

TEST_P(PsfEstimateOf, LeavesIsTheTruthWithinItsError) {
  const double truth = GetParam();
  for (const double noise : {1.0, 4.0}) {
    const testing::SequenceOptions options = Options(truth, noise);
    const Image<float> leaves = testing::LeafTruth(testing::TruthWidth(options), testing::TruthHeight(options), 5);
    const PsfEstimate estimate = EstimatePsfSigma(SpectrumOf(testing::RenderSequence(leaves, options)), options.fill_factor);
    Print("leaves", truth, noise, estimate);
    EXPECT_EQ(estimate.doubt, "");
    EXPECT_LT(std::abs(estimate.sigma_px - truth), 2.5 * estimate.error_px);
    EXPECT_LT(estimate.error_px, 0.09);
    if (estimate.noise_sigma > 0.0) {
      EXPECT_NEAR(estimate.noise_sigma / noise, 1.0, 0.12);
    }
  }
}

TEST_P(PsfEstimateOf, APhotographIsTheTruthWithinItsError) {
  const auto data = testing::TestDataDir();
  if (!data) GTEST_SKIP() << "the shared sample data are not here (../shared/data or TREM_TEST_DATA)";
  const std::string path = (*data / "truth" / "brighton_park.jpg").string();
  const double truth = GetParam();
  for (const auto& [x, y] : {std::pair{1660, 700}, std::pair{150, 300}, std::pair{900, 100}}) {
    const testing::SequenceOptions options = Options(truth, 2.0);
    const Image<float> picture = testing::ReadTruthPicture(path, x, y, testing::TruthWidth(options), testing::TruthHeight(options));
    ASSERT_FALSE(picture.empty());
    const PsfEstimate estimate = EstimatePsfSigma(SpectrumOf(testing::RenderSequence(picture, options)), options.fill_factor);
    Print("photograph", truth, 2.0, estimate);
    // So little blur shows beyond half a cycle a pixel only, where noise and aliases are.
    if (truth > 0.4) {
      EXPECT_EQ(estimate.doubt, "");
    }
    // 24 comparisons in all: one in eighty would be beyond by chance.
    EXPECT_LT(std::abs(estimate.sigma_px - truth), 2.5 * estimate.error_px);
  }
}

INSTANTIATE_TEST_SUITE_P(Widths, PsfEstimateOf, ::testing::Values(0.35, 0.5, 0.6, 0.8));

TEST(PsfEstimate, BadPixelsAndASmearedTileChangeLittle) {
  const testing::SequenceOptions options = Options(0.6, 2.0);
  testing::RenderedSequence sequence =
      testing::RenderSequence(testing::LeafTruth(testing::TruthWidth(options), testing::TruthHeight(options), 6), options);
  const PsfEstimate clean = EstimatePsfSigma(SpectrumOf(sequence), options.fill_factor);
  Rng rng({3});
  for (FrameInput& frame : sequence.frames) {
    for (float& pixel : frame.pixels.pixels()) {
      if (rng.Uniform() < 0.005) pixel = std::numeric_limits<float>::quiet_NaN();
    }
    for (int y = 0; y < 20; ++y) std::fill_n(frame.pixels.row(y), 20, std::numeric_limits<float>::quiet_NaN());
  }
  const FrameSpectrum spectrum = SpectrumOf(sequence);
  EXPECT_EQ(spectrum.tile_count(), 4 * 15) << "the masked corner's tile is left out";
  const PsfEstimate holed = EstimatePsfSigma(spectrum, options.fill_factor);
  EXPECT_EQ(holed.doubt, "");
  EXPECT_NEAR(holed.sigma_px, clean.sigma_px, 0.03);
}

TEST(PsfEstimate, NoTextureOrTooLittleOfItNoEstimate) {
  Rng rng({8});
  FrameSpectrum noise;
  for (int k = 0; k < 16; ++k) {
    Image<float> frame(161, 161);
    for (float& pixel : frame.pixels()) pixel = static_cast<float>(100.0 + 2.0 * rng.Normal());
    noise.Add(frame);
  }
  EXPECT_NE(EstimatePsfSigma(noise, 0.9).doubt, "");
  EXPECT_NE(EstimatePsfSigma(FrameSpectrum(), 0.9).doubt, "");
  FrameSpectrum black;
  for (int k = 0; k < 16; ++k) black.Add(Image<float>(161, 161));
  EXPECT_NE(EstimatePsfSigma(black, 0.9).doubt, "");
  FrameSpectrum small;
  small.Add(Image<float>(40, 200));
  EXPECT_EQ(small.tile_count(), 0);
}

TEST(PsfEstimate, PeriodicStructureIsNoGround) {
  Rng rng({9});
  FrameSpectrum spectrum;
  for (int k = 0; k < 4; ++k) {
    Image<float> frame(161, 161);
    for (int y = 0; y < 161; ++y) {
      for (int x = 0; x < 161; ++x) {
        const double wave = std::sin(0.9 * x + 0.2 * y + k) + std::sin(0.31 * x - 1.3 * y) + std::sin(2.1 * x + 1.7 * y);
        frame.at(x, y) = static_cast<float>(100.0 + 30.0 * wave + 2.0 * rng.Normal());
      }
    }
    spectrum.Add(frame);
  }
  const PsfEstimate estimate = EstimatePsfSigma(spectrum, 0.9);
  Print("waves", 0.0, 2.0, estimate);
  EXPECT_NE(estimate.doubt, "");
}

}  // namespace
}  // namespace trem
