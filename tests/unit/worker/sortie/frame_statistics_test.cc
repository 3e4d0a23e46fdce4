// Goal: noise and grey range estimates are right where truth is known. Method: normal noise of known sigma, plain and over texture;
// thresholds are several standard errors wide (about 1200 blocks a frame, each good to 6 %).
#include "worker/sortie/frame_statistics.h"

#include <gtest/gtest.h>

#include "mosaic/base/rng.h"
#include "tests/unit/worker/sortie/test_video.h"

namespace trem {
namespace {

Image<float> WithNoise(Image<float> frame, double sigma, std::uint64_t seed) {
  Rng rng({seed});
  for (float& value : frame.pixels()) value += static_cast<float>(sigma * rng.Normal());
  return frame;
}

TEST(EstimateNoiseSigma, IsUnbiasedOnPureNoise) {
  const Image<float> frame = WithNoise(Image<float>(640, 512, 100.0F), 3.0, 4);
  EXPECT_NEAR(EstimateNoiseSigma(frame, {0, 0, 640, 512}), 3.0, 0.09);
}

TEST(EstimateNoiseSigma, IsHardlyMisledByTexture) {
  const Image<float> frame = WithNoise(testing::TexturedFrame(640, 512, 0, 0, 2), 3.0, 4);
  EXPECT_NEAR(EstimateNoiseSigma(frame, {0, 0, 640, 512}), 3.0, 0.6);
}

TEST(EstimateNoiseSigma, IsZeroForAFrameSmallerThanABlock) { EXPECT_EQ(EstimateNoiseSigma(Image<float>(8, 8), {0, 0, 8, 8}), 0.0); }

TEST(PixelFingerprint, TellsFramesApartByOnePixelAndByShape) {
  Image<float> a(4, 6, 1.0F);
  Image<float> b = a;
  EXPECT_EQ(PixelFingerprint(a), PixelFingerprint(b));
  b.at(3, 5) = 1.0001F;
  EXPECT_NE(PixelFingerprint(a), PixelFingerprint(b));
  EXPECT_NE(PixelFingerprint(a), PixelFingerprint(Image<float>(6, 4, 1.0F)));
}

TEST(ChooseGreyScaling, KeepsEightBitSources) {
  QuantileSampler sampler;
  sampler.Add(testing::TexturedFrame(64, 48, 0, 0, 1));
  const GreyScaling scaling = ChooseGreyScaling(255.0, sampler, 0.0);
  EXPECT_EQ(scaling.offset, 0.0);
  EXPECT_EQ(scaling.scale, 1.0);
}

TEST(ChooseGreyScaling, MapsTheUsedRangeOfSixteenBitSourcesTo10To245) {
  QuantileSampler sampler;
  Rng rng({3});
  // Many frames, so that the sample is thinned; a tenth of each is black border.
  for (int i = 0; i < 600; ++i) {
    Image<float> frame(100, 50);
    for (int y = 5; y < 50; ++y) {
      for (int x = 0; x < 100; ++x) frame.at(x, y) = static_cast<float>(29000.0 + 2000.0 * rng.Uniform());
    }
    sampler.Add(frame);
  }
  const GreyScaling scaling = ChooseGreyScaling(65535.0, sampler, 0.1);
  EXPECT_NEAR((29010.0 - scaling.offset) / scaling.scale, 10.0, 1.5);
  EXPECT_NEAR((30990.0 - scaling.offset) / scaling.scale, 245.0, 1.5);
}

TEST(ChooseGreyScaling, SurvivesAConstantSource) {
  QuantileSampler sampler;
  sampler.Add(Image<float>(64, 48, 5000.0F));
  const GreyScaling scaling = ChooseGreyScaling(65535.0, sampler, 0.0);
  EXPECT_EQ(scaling.scale, 1.0);
  EXPECT_EQ(5000.0 - scaling.offset, 128.0);
}

}  // namespace
}  // namespace trem
