// Goal: weights follow read and photon noise without biasing what is averaged with them. Method: flat fields with signal-dependent noise,
// fixed seed; the rule that is used beside the two that are not.
#include "worker/sensor/noise_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

Image<float> NoisyFlat(double level, const NoiseModel& model, std::uint64_t seed) {
  Rng rng({seed, 77});
  Image<float> image(400, 400);
  for (float& pixel : image.pixels()) pixel = static_cast<float>(level + std::sqrt(model.Variance(level)) * rng.Normal());
  return image;
}

double WeightedMean(const Image<float>& image, const Image<float>& weights) {
  double sum = 0.0;
  double weight = 0.0;
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    sum += static_cast<double>(weights.pixels()[i]) * image.pixels()[i];
    weight += weights.pixels()[i];
  }
  return sum / weight;
}

TEST(NoiseWeights, AreTheInverseVarianceOfTheSignalAround) {
  const NoiseModel model{4.0, 0.5, 10.0};
  const Image<float> weights = NoiseWeights(Image<float>(20, 20, 60.0F), model);
  for (const float weight : weights.pixels()) EXPECT_NEAR(weight, 10.0 / 34.0, 1e-6);
  EXPECT_NEAR(NoiseWeights(Image<float>(9, 9, -20.0F), model).at(4, 4), 10.0 / 4.0, 1e-6) << "below black there are no photons";
  EXPECT_NEAR(NoiseWeights(Image<float>(1, 1, 60.0F), model).at(0, 0), 10.0 / 34.0, 1e-6) << "nothing around it";
}

TEST(NoiseWeights, DoNotBiasAnAverageAsThePixelsOwnValueWould) {
  const NoiseModel model{1.0, 0.6, 25.0};
  const Image<float> frame = NoisyFlat(40.0, model, 5);
  Image<float> own(400, 400);
  for (std::size_t i = 0; i < own.pixels().size(); ++i) {
    own.pixels()[i] = static_cast<float>(model.typical_variance / model.Variance(frame.pixels()[i]));
  }
  // 4 standard errors of the mean of 160 000 pixels with sigma 5: 0.05.
  const double mean = WeightedMean(frame, Image<float>(400, 400, 1.0F));
  EXPECT_NEAR(WeightedMean(frame, NoiseWeights(frame, model)) - mean, 0.0, 0.05);
  EXPECT_LT(WeightedMean(frame, own) - mean, -0.4) << "the rule that is not used: about -shot grey levels";
}

TEST(NoiseWeights, NanPixelsWeighNothingAndSpreadNothing) {
  Image<float> frame(11, 11, 50.0F);
  frame.at(5, 5) = std::numeric_limits<float>::quiet_NaN();
  const NoiseModel model{4.0, 0.5, 10.0};
  const Image<float> weights = NoiseWeights(frame, model);
  EXPECT_EQ(weights.at(5, 5), 0.0F);
  EXPECT_NEAR(weights.at(6, 5), 10.0 / 29.0, 1e-6);
}

}  // namespace
}  // namespace trem
