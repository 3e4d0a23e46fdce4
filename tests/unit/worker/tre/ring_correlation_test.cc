// Goal: the limit of agreement lies where the pictures' signal-to-noise ratio says, whatever filter either went through, and neither the
// signal's strong low frequencies nor unseen cells fake an agreement. Method: fields of noise below a known frequency, or falling steeply,
// with independent noise on each picture.
#include "worker/tre/ring_correlation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

constexpr int kSide = 200;

// A sum of waves of random direction, phase and frequency between `low` and `high` [cycles a cell]; variance 1.
Image<float> Waves(double low, double high, std::uint64_t seed) {
  constexpr int kWaves = 1500;
  Rng rng({seed, 11});
  Image<double> sum(kSide, kSide, 0.0);
  for (int k = 0; k < kWaves; ++k) {
    // Uniform over the disc's area: white within the ring.
    const double f = std::sqrt(low * low + (high * high - low * low) * rng.Uniform());
    const double angle = 2.0 * std::numbers::pi * rng.Uniform();
    const double phase = 2.0 * std::numbers::pi * rng.Uniform();
    const double u = 2.0 * std::numbers::pi * f * std::cos(angle);
    const double v = 2.0 * std::numbers::pi * f * std::sin(angle);
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) sum.at(x, y) += std::cos(u * x + v * y + phase);
    }
  }
  Image<float> waves(kSide, kSide);
  for (std::size_t i = 0; i < waves.pixels().size(); ++i) waves.pixels()[i] = static_cast<float>(sum.pixels()[i] * std::sqrt(2.0 / kWaves));
  return waves;
}

Image<float> WithNoise(Image<float> image, double sigma, std::uint64_t seed) {
  Rng rng({seed, 12});
  for (float& pixel : image.pixels()) pixel += static_cast<float>(sigma * rng.Normal());
  return image;
}

TEST(RingCorrelation, TheLimitIsWhereTheSignalEnds) {
  for (const double end : {0.15, 0.25, 0.35}) {
    const Image<float> signal = Waves(0.0, end, 1);
    EXPECT_NEAR(AgreementLimit(WithNoise(signal, 1.5, 1), WithNoise(signal, 1.5, 2)), end, 2.0 / 64.0) << end;
    // A spectrum that ends abruptly a thousand times above the noise is smeared by the window's main lobe.
    const double sharp = AgreementLimit(WithNoise(signal, 0.1, 1), WithNoise(signal, 0.1, 2));
    EXPECT_GT(sharp, end) << end;
    EXPECT_LT(sharp, end + 3.5 / 64.0) << end;
  }
}

TEST(RingCorrelation, StrongLowFrequenciesDoNotLeakIntoAnAgreement) {
  Image<float> signal = Waves(0.0, 0.05, 2);
  for (float& pixel : signal.pixels()) pixel *= 1000.0F;
  EXPECT_LT(AgreementLimit(WithNoise(signal, 0.1, 1), WithNoise(signal, 0.1, 2)), 0.14);
}

TEST(RingCorrelation, AgreementEverywhereIsTheGridsLimitAndNoneIsNone) {
  const Image<float> signal = WithNoise(Image<float>(kSide, kSide), 1.0, 3);
  EXPECT_EQ(AgreementLimit(signal, signal), 0.5);
  EXPECT_LT(AgreementLimit(signal, WithNoise(Image<float>(kSide, kSide), 1.0, 4)), 0.08);
}

TEST(RingCorrelation, AFilterOnOnePictureChangesLittle) {
  const Image<float> signal = Waves(0.0, 0.25, 5);
  const Image<float> a = WithNoise(signal, 0.3, 1);
  const Image<float> b = WithNoise(signal, 0.3, 2);
  Image<float> smooth = b;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 1; x + 1 < kSide; ++x) smooth.at(x, y) = 0.25F * b.at(x - 1, y) + 0.5F * b.at(x, y) + 0.25F * b.at(x + 1, y);
  }
  EXPECT_NEAR(AgreementLimit(a, smooth), AgreementLimit(a, b), 0.01);
}

TEST(RingCorrelation, UnseenCellsAreLeftOut) {
  const Image<float> signal = Waves(0.0, 0.25, 6);
  Image<float> a = WithNoise(signal, 0.1, 1);
  const double whole = AgreementLimit(a, WithNoise(signal, 0.1, 2));
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < 70; ++x) a.at(x, y) = std::numeric_limits<float>::quiet_NaN();
  }
  EXPECT_NEAR(AgreementLimit(a, WithNoise(signal, 0.1, 2)), whole, 0.02);
  EXPECT_EQ(AgreementLimit(Image<float>(kSide, kSide, std::numeric_limits<float>::quiet_NaN()), signal), 0.0);
  EXPECT_EQ(AgreementLimit(Image<float>(40, 40, 1.0F), Image<float>(40, 40, 1.0F)), 0.0) << "smaller than a tile";
}

}  // namespace
}  // namespace trem
