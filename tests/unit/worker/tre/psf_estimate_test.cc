// Goal: the width of the PSF is found from the frames alone, rather below than above the truth, and an estimate that the data do not
// support is not made. Method: sequences rendered by an independent sensor with known widths, fixed seeds; frames without texture, frames
// of noise, a camera that stands still.
#include "worker/tre/psf_estimate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"

namespace trem {
namespace {

std::vector<PsfTrial> Trials(double psf_sigma_px, double noise_sigma, double speed_px, std::uint64_t seed) {
  std::vector<PsfTrial> trials;
  for (std::uint64_t k = 0; k < 2; ++k) {
    testing::SequenceOptions options;
    options.frame_count = 16;
    options.roi_px = 61;
    options.psf_sigma_px = psf_sigma_px;
    options.noise_sigma = noise_sigma;
    options.speed_px = speed_px;
    options.seed = 100 * seed + k;
    testing::RenderedSequence sequence = testing::RenderSequence(options);
    trials.push_back({sequence.roi, std::move(sequence.frames)});
  }
  return trials;
}

EngineOptions WithNoise(double noise_sigma) {
  EngineOptions options;
  options.noise_sigma = noise_sigma;
  return options;
}

class PsfEstimateOf : public ::testing::TestWithParam<double> {};

// Seen with these seeds: errors of -0.09 to +0.06 px (printed).
TEST_P(PsfEstimateOf, IsNearTheTruthAndWithinItsError) {
  const double truth = GetParam();
  for (const double noise : {1.0, 3.0}) {
    const auto estimate = EstimatePsfSigma(Trials(truth, noise, 1.1, 1), WithNoise(noise), {});
    ASSERT_TRUE(estimate.ok());
    std::printf("true %.2f px, noise %.0f: %.3f +- %.3f px, noise %.2f %s\n", truth, noise, estimate->sigma_px, estimate->error_px,
                estimate->noise_sigma, estimate->doubt.c_str());
    EXPECT_EQ(estimate->doubt, "");
    EXPECT_GT(estimate->sigma_px, truth - 0.10);
    EXPECT_LT(estimate->sigma_px, truth + 0.07);
    EXPECT_LT(std::abs(estimate->sigma_px - truth), 3.0 * estimate->error_px);
    EXPECT_NEAR(estimate->noise_sigma / noise, 1.05, 0.1);
  }
}

INSTANTIATE_TEST_SUITE_P(Widths, PsfEstimateOf, ::testing::Values(0.35, 0.5, 0.6, 0.8));

TEST(PsfEstimate, ANoiseGuessThatTextureInflatedIsCorrected) {
  const auto estimate = EstimatePsfSigma(Trials(0.6, 2.0, 1.1, 2), WithNoise(5.0), {});
  ASSERT_TRUE(estimate.ok());
  EXPECT_NEAR(estimate->noise_sigma, 2.1, 0.25);
  EXPECT_NEAR(estimate->sigma_px, 0.58, 0.10);
}

TEST(PsfEstimate, NoTextureNoEstimate) {
  Rng rng({8});
  PsfTrial trial{{0, 0, 61, 61}, {}};
  for (int k = 0; k < 16; ++k) {
    FrameInput frame;
    frame.frame_index = k;
    frame.pixels = Image<float>(61, 61);
    for (float& pixel : frame.pixels.pixels()) pixel = static_cast<float>(100.0 + 2.0 * rng.Normal());
    trial.frames.push_back(std::move(frame));
  }
  const std::vector<PsfTrial> trials{trial};
  const auto estimate = EstimatePsfSigma(trials, WithNoise(2.0), {});
  ASSERT_TRUE(estimate.ok());
  EXPECT_NE(estimate->doubt, "");
  EXPECT_NE(EstimatePsfSigma({}, WithNoise(2.0), {})->doubt, "");
}

TEST(PsfEstimate, StopsWhenAsked) {
  const auto stopped = EstimatePsfSigma(Trials(0.6, 2.0, 1.1, 2), WithNoise(2.0), [](double) { return false; });
  ASSERT_FALSE(stopped.ok());
  EXPECT_EQ(stopped.status().code(), StatusCode::kCancelled);
}

}  // namespace
}  // namespace trem
