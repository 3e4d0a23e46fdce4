// Goal: the weighted median is what its definition says, whatever the order of the samples. Method: brute force (the quantile function
// integrated numerically from its definition; the textbook median of repeated samples for whole weights) and properties on random sets.
#include "mosaic/composite/median.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

std::vector<WeightedSample> RandomSamples(Rng& rng, int count, bool coarse_values) {
  std::vector<WeightedSample> samples;
  for (int i = 0; i < count; ++i) {
    WeightedSample sample;
    const double value = 100.0 * rng.Uniform();
    sample.value = static_cast<float>(coarse_values ? std::floor(value / 20.0) : value);
    sample.weight = static_cast<float>(0.05 + rng.Uniform());
    sample.source = static_cast<std::uint32_t>(i);
    samples.push_back(sample);
  }
  return samples;
}

float MedianOf(std::vector<WeightedSample> samples, double blend) { return WeightedMedian(samples, MedianOptions{blend}); }

// The textbook median of plain numbers.
double PlainMedian(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return n % 2 == 1 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

TEST(WeightedMedian, WithWholeWeightsIsTheMedianOfRepeatedSamples) {
  Rng rng({1});
  for (int trial = 0; trial < 2000; ++trial) {
    std::vector<WeightedSample> samples = RandomSamples(rng, 1 + trial % 9, trial % 2 == 0);
    std::vector<double> repeated;
    for (WeightedSample& sample : samples) {
      const int times = 1 + static_cast<int>(4.0 * rng.Uniform());
      sample.weight = static_cast<float>(times);
      repeated.insert(repeated.end(), static_cast<std::size_t>(times), sample.value);
    }
    ASSERT_FLOAT_EQ(MedianOf(samples, 0.0), static_cast<float>(PlainMedian(repeated))) << "trial " << trial;
  }
}

TEST(WeightedMedian, BlendedIsTheMeanOfTheCentralQuantiles) {
  Rng rng({2});
  constexpr int kSteps = 20000;
  for (int trial = 0; trial < 100; ++trial) {
    std::vector<WeightedSample> samples = RandomSamples(rng, 1 + trial % 8, false);
    std::sort(samples.begin(), samples.end(), [](const auto& a, const auto& b) { return a.value < b.value; });
    double total = 0.0;
    for (const WeightedSample& sample : samples) total += sample.weight;
    double sum = 0.0;
    for (int step = 0; step < kSteps; ++step) {
      const double p = (0.4 + 0.2 * (step + 0.5) / kSteps) * total;
      double below = 0.0;
      std::size_t i = 0;
      while (i + 1 < samples.size() && below + samples[i].weight < p) below += samples[i++].weight;
      sum += samples[i].value;
    }
    ASSERT_NEAR(MedianOf(samples, 0.1), sum / kSteps, 0.05) << "trial " << trial;
  }
}

TEST(WeightedMedian, BlendedIsThePlainMedianOfAFewEqualWeights) {
  Rng rng({3});
  for (const int count : {1, 2, 3, 4, 5, 6, 8, 10}) {
    std::vector<WeightedSample> samples = RandomSamples(rng, count, false);
    std::vector<double> values;
    for (WeightedSample& sample : samples) {
      sample.weight = 0.7f;
      values.push_back(sample.value);
    }
    EXPECT_NEAR(MedianOf(samples, 0.1), PlainMedian(values), 1e-4) << count << " samples";
  }
}

TEST(WeightedMedian, DoesNotDependOnTheOrderOfTheSamples) {
  Rng rng({4});
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<WeightedSample> samples = RandomSamples(rng, 2 + trial % 12, trial % 2 == 0);
    std::vector<WeightedSample> reversed(samples.rbegin(), samples.rend());
    std::vector<WeightedSample> rotated = samples;
    std::rotate(rotated.begin(), rotated.begin() + 1, rotated.end());
    for (const double blend : {0.0, 0.1}) {
      std::vector<WeightedSample> copy = samples;
      const PixelMedian expected = ReducePixel(copy, MedianOptions{blend});
      for (std::vector<WeightedSample> other : {reversed, rotated}) {
        const PixelMedian found = ReducePixel(other, MedianOptions{blend});
        ASSERT_EQ(found.median, expected.median);
        ASSERT_EQ(found.nmad, expected.nmad);
        ASSERT_EQ(found.source, expected.source);
      }
    }
  }
}

TEST(WeightedMedian, IsContinuousInTheWeightsWhenBlended) {
  // A third sample that fades in must not make the result jump; two samples must cross-fade.
  const auto three = [](float weight) { return MedianOf({{100.0f, 1.0f, 0}, {110.0f, 1.0f, 1}, {104.0f, weight, 2}}, 0.1); };
  EXPECT_NEAR(three(1e-6f), MedianOf({{100.0f, 1.0f, 0}, {110.0f, 1.0f, 1}}, 0.1), 1e-3);
  float last = MedianOf({{0.0f, 1.0f, 0}, {10.0f, 0.2f, 1}}, 0.1);
  for (float weight = 0.2f; weight < 5.0f; weight *= 1.02f) {
    const float now = MedianOf({{0.0f, 1.0f, 0}, {10.0f, weight, 1}}, 0.1);
    EXPECT_LT(std::abs(now - last), 0.5f);
    last = now;
  }
}

TEST(WeightedMedian, ResistsFourTenthsOfTheWeightBeingWrong) {
  Rng rng({5});
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<WeightedSample> samples;
    double good = 0.0, bad = 0.0;
    for (int i = 0; i < 12; ++i) {
      const float weight = static_cast<float>(0.1 + rng.Uniform());
      const bool is_bad = bad + weight < 0.39 / 0.61 * (good + 1e-9);
      (is_bad ? bad : good) += weight;
      samples.push_back({is_bad ? 1e6f : static_cast<float>(50.0 + rng.Uniform()), weight, static_cast<std::uint32_t>(i)});
    }
    const float median = MedianOf(samples, 0.1);
    ASSERT_GE(median, 50.0f);
    ASSERT_LE(median, 51.0f);
  }
}

PixelMedian BiweightOf(std::vector<WeightedSample> samples) { return ReducePixel(samples, MedianOptions{0.1, Estimator::kBiweight}); }

TEST(Biweight, IsLessNoisyThanTheMedian) {
  // Variances of ten Gaussian samples over 4000 trials; their ratio, near 0.75, is known to 0.02 (they are correlated by 0.8). 1: no gain.
  Rng rng({21});
  double biweight2 = 0.0, median2 = 0.0;
  for (int trial = 0; trial < 4000; ++trial) {
    std::vector<WeightedSample> samples;
    for (std::uint32_t i = 0; i < 10; ++i) samples.push_back({static_cast<float>(rng.Normal()), 1.0f, i});
    const float biweight = BiweightOf(samples).median;
    const float median = ReducePixel(samples, MedianOptions{0.0}).median;
    biweight2 += biweight * biweight;
    median2 += median * median;
  }
  EXPECT_LT(biweight2, 0.85 * median2);
}

TEST(Biweight, LeavesOutWhatIsFarFromTheOthers) {
  Rng rng({22});
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<WeightedSample> samples;
    for (std::uint32_t i = 0; i < 9; ++i) {
      const bool wrong = i < 3;
      samples.push_back({static_cast<float>(wrong ? 5000.0 * rng.Uniform() + 200.0 : 50.0 + rng.Uniform()), 1.0f, i});
    }
    const PixelMedian pixel = BiweightOf(samples);
    ASSERT_GE(pixel.median, 50.0f);
    ASSERT_LE(pixel.median, 51.0f);
  }
}

TEST(Biweight, IsTheMedianWhereMostSamplesAreEqualAndTheMeanOfTwo) {
  EXPECT_EQ(BiweightOf({{7.0f, 1.0f, 0}, {7.0f, 1.0f, 1}, {7.0f, 1.0f, 2}, {900.0f, 1.0f, 3}}).median, 7.0f);
  EXPECT_NEAR(BiweightOf({{10.0f, 1.0f, 0}, {20.0f, 1.0f, 1}}).median, 15.0f, 1e-5);
  EXPECT_EQ(BiweightOf({{3.5f, 0.2f, 0}}).median, 3.5f);
}

TEST(Biweight, WeighsItsSamples) {
  // Far enough apart for the floor not to matter.
  const PixelMedian pixel = BiweightOf({{1000.0f, 2.0f, 0}, {1100.0f, 1.0f, 1}, {1200.0f, 2.0f, 2}, {1220.0f, 6.0f, 3}});
  EXPECT_GT(pixel.median, 1190.0f);
  EXPECT_LT(pixel.median, 1220.0f);
}

TEST(ReducePixel, GivesEverySampleOneVoteWhenAskedTo) {
  std::vector<WeightedSample> samples = {{1.0f, 10.0f, 0}, {2.0f, 0.1f, 1}, {9.0f, 0.1f, 2}};
  const PixelMedian pixel = ReducePixel(samples, MedianOptions{0.1, Estimator::kMedian});
  EXPECT_EQ(pixel.median, 2.0f);
  EXPECT_FLOAT_EQ(pixel.nmad, 1.4826f);
  EXPECT_EQ(pixel.source, 0u);
}

TEST(ReducePixel, NmadIsTheStandardDeviationOfGaussianNoise) {
  // Means over five pixels of 4001 samples each.
  Rng rng({6});
  double median = 0.0, nmad = 0.0;
  for (int trial = 0; trial < 5; ++trial) {
    std::vector<WeightedSample> samples;
    for (std::uint32_t i = 0; i < 4001; ++i) samples.push_back({static_cast<float>(7.0 + 3.0 * rng.Normal()), 1.0f, i});
    const PixelMedian pixel = ReducePixel(samples, MedianOptions{});
    EXPECT_EQ(pixel.count, 4001);
    median += pixel.median / 5.0;
    nmad += pixel.nmad / 5.0;
  }
  // Standard errors: of the median 1.25 sigma / sqrt(n) = 0.027; of the NMAD 1.17 sigma / sqrt(n) = 0.025. Five of them: 6e-7.
  EXPECT_NEAR(median, 7.0, 0.14);
  EXPECT_NEAR(nmad, 3.0, 0.13);
}

TEST(ReducePixel, DominantSourceIsTheHeaviestAndTheLeastAmongEquals) {
  std::vector<WeightedSample> samples = {{1.0f, 0.5f, 9}, {2.0f, 0.9f, 7}, {3.0f, 0.9f, 4}, {4.0f, 0.1f, 1}};
  EXPECT_EQ(ReducePixel(samples, MedianOptions{}).source, 4u);
}

}  // namespace
}  // namespace trem
