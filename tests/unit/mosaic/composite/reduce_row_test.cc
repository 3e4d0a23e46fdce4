// Goal: the vector reduction gives, pixel by pixel and bit by bit, what ReducePixel gives on the same samples, on every SIMD target that
// this processor has. Method: rows with random columns, gaps, ties, poor samples, negative and huge values, from none to ninety; every
// estimator; compared with ReducePixel, and every target with the first.
#include "mosaic/composite/reduce_row.h"

#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/simd_targets.h"

namespace trem {
namespace {

constexpr int kWidth = 203;

struct Rows {
  std::vector<std::vector<float>> planes;
  std::vector<SampleRow> rows;
};

Rows RandomRows(int count, std::uint64_t seed) {
  Rows made;
  Rng rng({seed, static_cast<std::uint64_t>(count)});
  for (int k = 0; k < count; ++k) {
    SampleRow row;
    row.begin = rng.Uniform() < 0.5 ? -7 : static_cast<int>(rng.UniformIndex(60));
    row.end = rng.Uniform() < 0.5 ? kWidth + 9 : kWidth - static_cast<int>(rng.UniformIndex(60));
    const auto size = static_cast<std::size_t>(row.end - row.begin);
    std::vector<float> value(size), weight(size), saturation(size);
    for (std::size_t i = 0; i < size; ++i) {
      const double kind = rng.Uniform();
      value[i] = static_cast<float>(kind < 0.3 ? std::floor(5.0 * rng.Uniform()) : 40.0 * rng.Normal());
      if (kind > 0.99) value[i] = 1e30f;
      weight[i] = rng.Uniform() < 0.2 ? 0.0f : static_cast<float>(rng.Uniform() < 0.3 ? 0.5 : 1e-4 + rng.Uniform());
      saturation[i] = static_cast<float>(rng.Uniform());
    }
    row.sigma2 = static_cast<float>(rng.Uniform());
    row.source = static_cast<float>(k / 2 + 3);
    made.planes.push_back(std::move(value));
    made.planes.push_back(std::move(weight));
    made.planes.push_back(std::move(saturation));
    made.rows.push_back(row);
  }
  for (std::size_t k = 0; k < made.rows.size(); ++k) {
    made.rows[k].value = made.planes[3 * k].data();
    made.rows[k].weight = made.planes[3 * k + 1].data();
    made.rows[k].saturation = made.planes[3 * k + 2].data();
  }
  return made;
}

struct Reduced {
  std::vector<float> value, count, nmad, sigma, source;
  Reduced() : value(kWidth), count(kWidth), nmad(kWidth), sigma(kWidth), source(kWidth) {}
  ReducedRow row() { return {value.data(), count.data(), nmad.data(), sigma.data(), source.data()}; }
};

ReduceOptions OptionsFor(Estimator estimator, double blend) {
  ReduceOptions options;
  options.median.estimator = estimator;
  options.median.blend = blend;
  return options;
}

const std::vector<ReduceOptions> kAllOptions = {OptionsFor(Estimator::kWeightedMedian, 0.1), OptionsFor(Estimator::kWeightedMedian, 0.0),
                                                OptionsFor(Estimator::kMedian, 0.1), OptionsFor(Estimator::kBiweight, 0.1)};

// What the header promises, written down pixel by pixel.
Reduced Expected(const Rows& rows, const ReduceOptions& options) {
  Reduced expected;
  for (int x = 0; x < kWidth; ++x) {
    const auto at = static_cast<std::size_t>(x);
    const auto given = [&](const SampleRow& row) { return x >= row.begin && x < row.end && row.weight[x - row.begin] > 0.0f; };
    float best = 0.0f;
    for (const SampleRow& row : rows.rows) {
      if (given(row)) best = std::max(best, row.saturation[x - row.begin]);
    }
    std::vector<WeightedSample> samples;
    float weight_sum = 0.0f, sigma2_sum = 0.0f;
    for (std::size_t k = 0; k < rows.rows.size(); ++k) {
      const SampleRow& row = rows.rows[k];
      if (!given(row)) continue;
      const float saturation = row.saturation[x - row.begin];
      if (saturation < 0.5f && saturation < options.poor_ratio * best) continue;
      const float weight = row.weight[x - row.begin];
      samples.push_back({row.value[x - row.begin], weight, static_cast<std::uint32_t>(k)});
      weight_sum += weight;
      sigma2_sum += weight * row.sigma2;
    }
    expected.count[at] = static_cast<float>(samples.size());
    expected.value[at] = expected.nmad[at] = expected.sigma[at] = std::numeric_limits<float>::quiet_NaN();
    expected.source[at] = options.no_source;
    if (samples.empty()) continue;
    const PixelMedian pixel = ReducePixel(samples, options.median);
    expected.value[at] = pixel.median;
    if (samples.size() > 1) expected.nmad[at] = pixel.nmad;
    expected.sigma[at] = std::sqrt(sigma2_sum / weight_sum);
    expected.source[at] = rows.rows[pixel.source].source;
  }
  return expected;
}

void ExpectSame(const std::vector<float>& found, const std::vector<float>& expected, const char* plane, const std::string& where) {
  for (std::size_t i = 0; i < expected.size(); ++i) {
    if (std::isnan(expected[i]) && std::isnan(found[i])) continue;
    ASSERT_EQ(0, std::memcmp(&found[i], &expected[i], sizeof(float)))
        << plane << " of column " << i << " is " << found[i] << ", expected " << expected[i] << " " << where;
  }
}

std::vector<std::int64_t> AllTargets() {
  std::vector<std::int64_t> targets;
  std::int64_t left = hwy::SupportedTargets() & HWY_TARGETS;
  for (; left != 0; left &= left - 1) targets.push_back(left & -left);
  return targets;
}

TEST(ReduceRow, EqualsReducePixelBitForBitOnEveryTarget) {
  const std::vector<std::int64_t> targets = AllTargets();
  ASSERT_GE(targets.size(), 1u);
  for (const int count : {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 16, 31, 64, 65, 90}) {
    const Rows rows = RandomRows(count, 7);
    for (std::size_t o = 0; o < kAllOptions.size(); ++o) {
      Reduced expected = Expected(rows, kAllOptions[o]);
      for (const std::int64_t target : targets) {
        const testing::WithTarget with(target);
        Reduced found;
        ReduceRow(rows.rows, kWidth, kAllOptions[o], found.row());
        const std::string where =
            "(" + std::to_string(count) + " rows, options " + std::to_string(o) + ", target " + hwy::TargetName(target) + ")";
        ExpectSame(found.value, expected.value, "value", where);
        ExpectSame(found.count, expected.count, "count", where);
        ExpectSame(found.nmad, expected.nmad, "nmad", where);
        ExpectSame(found.sigma, expected.sigma, "position sigma", where);
        ExpectSame(found.source, expected.source, "source", where);
        if (HasFatalFailure()) return;
      }
    }
  }
}

TEST(ReduceRow, RowsThatSayNothingOfAPixelDoNotChangeIt) {
  // Among 70 rows most pixels are covered by 30; the others must not change their bytes.
  Rows many = RandomRows(70, 11);
  for (std::size_t k = 30; k < 70; ++k) {
    for (float& weight : many.planes[3 * k + 1]) weight = 0.0f;
  }
  Rows few = many;
  few.rows.resize(30);
  for (const ReduceOptions& options : kAllOptions) {
    Reduced a, b;
    ReduceRow(many.rows, kWidth, options, a.row());
    ReduceRow(few.rows, kWidth, options, b.row());
    ExpectSame(a.value, b.value, "value", "(70 rows beside 30)");
    ExpectSame(a.nmad, b.nmad, "nmad", "(70 rows beside 30)");
  }
}

}  // namespace
}  // namespace trem
