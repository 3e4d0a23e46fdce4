// Goal: the covariance that a segment reports of its views covers the true error at its nominal rate on frames that the engine's own model
// did not make, with any noise and ROI size, where the camera dwells and where it crosses new ground.
// Method: frames rendered from procedural ground by dense quadrature (tests/support/rendered_sequence.h), truth on the plane of the first
// frame. The frames of a sequence share most of their error, so the sequences count and not the frames: the seeds are fixed, and the
// tests hold the rate of all sequences of a kind.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstdio>
#include <vector>

#include "tests/support/rendered_sequence.h"
#include "worker/tre/segment.h"

namespace trem {
namespace {

struct Flight {
  int width = 41;
  int height = 71;
  double speed_px = 0.1;
  double noise_sigma = 2.0;
  int frames = 24;
  int sequences = 24;
};

struct Tally {
  double covered = 0.0;
  double chi2 = 0.0;  // Sum, per degree of freedom.
  double frames = 0.0;
};

void Count(const Flight& flight, std::uint64_t seed, Tally* tally) {
  constexpr double kLimit = 12.592;  // 95 % of chi-square with 6 degrees of freedom.
  testing::SequenceOptions options;
  options.frame_count = flight.frames;
  options.roi_px = std::max(flight.width, flight.height);
  options.speed_px = flight.speed_px;
  options.noise_sigma = flight.noise_sigma;
  options.seed = seed;
  const testing::RenderedSequence sequence = testing::RenderSequence(options);
  const Roi roi{0, 0, flight.width, flight.height};
  EngineOptions engine;
  engine.psf.sigma_px = options.psf_sigma_px;
  engine.psf.fill_factor = options.fill_factor;
  Segment segment(roi, *MakePsf(engine.psf, engine.ratio), engine, 0);
  for (std::size_t t = 0; t < sequence.frames.size(); ++t) {
    FrameInput frame = sequence.frames[t];
    Image<float> pixels(flight.width, flight.height);
    for (int v = 0; v < flight.height; ++v) std::copy_n(frame.pixels.row(v), flight.width, pixels.row(v));
    frame.pixels = std::move(pixels);
    if (t == 0) {
      (void)segment.Begin(frame, flight.noise_sigma);
      continue;
    }
    const JudgedRegistration judged = segment.RegisterFrame(frame, flight.noise_sigma);
    ASSERT_EQ(judged.doubt, "") << "seed " << seed << ", frame " << t;
    (void)segment.AddFrame(frame, judged.registration, flight.noise_sigma, [](const SceneSnapshot&) { return Status{}; });
    const Affine expected = sequence.TruthFromScene(0).Inverse() * sequence.truth_from_sensor[t];
    const CornerVector d = CornerDisplacement(judged.registration.view.scene_from_sensor, expected, roi);
    const double chi2 = d.dot(judged.registration.corner_covariance.ldlt().solve(d));
    tally->covered += chi2 <= kLimit ? 1.0 : 0.0;
    tally->chi2 += chi2 / 6.0;
    ++tally->frames;
  }
}

// Part of all frames of `flights` inside their 95 % ellipsoids.
double Coverage(const std::vector<Flight>& flights) {
  Tally all;
  std::uint64_t seed = 7000;
  for (const Flight& flight : flights) {
    Tally own;
    for (int k = 0; k < flight.sequences; ++k) Count(flight, ++seed, &own);
    std::printf("%d x %d px, %.1f px a frame, noise %.1f: chi2/dof %.2f, %.1f %% covered\n", flight.width, flight.height, flight.speed_px,
                flight.noise_sigma, own.chi2 / own.frames, 100.0 * own.covered / own.frames);
    all.covered += own.covered;
    all.frames += own.frames;
  }
  return all.covered / all.frames;
}

void ExpectNominal(double coverage) {
  EXPECT_GE(coverage, 0.92);
  EXPECT_LE(coverage, 0.98);
}

TEST(SegmentCoverage, IsNominalWhereTheCameraDwells) {
  ExpectNominal(Coverage({{.noise_sigma = 1.0}, {.noise_sigma = 2.0}, {.noise_sigma = 5.0}, {.width = 61, .height = 61, .sequences = 16}}));
}

TEST(SegmentCoverage, IsNominalOfALargeRoi) { ExpectNominal(Coverage({{.width = 151, .height = 151, .frames = 12, .sequences = 16}})); }

TEST(SegmentCoverage, IsNominalOverNewGround) {
  ExpectNominal(Coverage({{.speed_px = 1.9, .noise_sigma = 1.0, .frames = 40, .sequences = 20},
                          {.speed_px = 1.9, .frames = 40, .sequences = 20},
                          {.speed_px = 1.9, .noise_sigma = 5.0, .frames = 40, .sequences = 20},
                          {.speed_px = 0.8, .frames = 50, .sequences = 12},
                          {.width = 81, .height = 81, .speed_px = 1.9, .frames = 40, .sequences = 8}}));
}

}  // namespace
}  // namespace trem
