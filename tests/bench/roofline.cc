#include "tests/bench/roofline.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <vector>

#include "tests/bench/cpu_clock.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "tests/bench/roofline.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace trem::bench::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Twelve independent chains: more than latency times throughput of any processor's multiply-add units. They begin with values that the
// compiler doesn't know (`start` has one for each): it would work out chains that begin alike once. Returns the operations done.
double MultiplyAdd(long rounds, const float* start, float* sink) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const V a = hn::Set(d, 0.999F);
  const V b = hn::Set(d, 0.001F);
  const auto chain = [&](int k) HWY_ATTR { return hn::Set(d, start[k]); };
  V s0 = chain(0), s1 = chain(1), s2 = chain(2), s3 = chain(3), s4 = chain(4), s5 = chain(5);
  V s6 = chain(6), s7 = chain(7), s8 = chain(8), s9 = chain(9), s10 = chain(10), s11 = chain(11);
  for (long i = 0; i < rounds; ++i) {
    s0 = hn::MulAdd(s0, a, b);
    s1 = hn::MulAdd(s1, a, b);
    s2 = hn::MulAdd(s2, a, b);
    s3 = hn::MulAdd(s3, a, b);
    s4 = hn::MulAdd(s4, a, b);
    s5 = hn::MulAdd(s5, a, b);
    s6 = hn::MulAdd(s6, a, b);
    s7 = hn::MulAdd(s7, a, b);
    s8 = hn::MulAdd(s8, a, b);
    s9 = hn::MulAdd(s9, a, b);
    s10 = hn::MulAdd(s10, a, b);
    s11 = hn::MulAdd(s11, a, b);
  }
  const V low = hn::Add(hn::Add(hn::Add(s0, s1), hn::Add(s2, s3)), hn::Add(s4, s5));
  const V high = hn::Add(hn::Add(hn::Add(s6, s7), hn::Add(s8, s9)), hn::Add(s10, s11));
  hn::StoreU(hn::Add(low, high), d, sink);
  return 2.0 * 12.0 * static_cast<double>(rounds) * static_cast<double>(hn::Lanes(d));
}

}  // namespace trem::bench::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem::bench {

HWY_EXPORT(MultiplyAdd);

namespace {

double SecondsOf(const auto& work) {
  const double start = ThreadCpuMs();
  work();
  return 1e-3 * (ThreadCpuMs() - start);
}

constexpr int kTrials = 7;

}  // namespace

double PeakFlopsPerSecond() {
  static const double peak = [] {
    std::vector<float> sink(64);
    std::vector<float> start(12);
    for (std::size_t k = 0; k < start.size(); ++k) start[k] = 0.1F * static_cast<float>(k);
    benchmark::DoNotOptimize(start.data());
    double best = 0.0;
    for (int trial = 0; trial < kTrials; ++trial) {
      double done = 0.0;
      const double seconds = SecondsOf([&] { done = HWY_DYNAMIC_DISPATCH(MultiplyAdd)(2'000'000, start.data(), sink.data()); });
      benchmark::DoNotOptimize(sink.data());
      best = std::max(best, done / seconds);
    }
    return best;
  }();
  return peak;
}

double CopyBytesPerSecond(std::size_t moved_bytes) {
  static std::map<std::size_t, double> measured;
  const std::size_t half = std::max<std::size_t>(moved_bytes / 2, 4096);
  double& rate = measured[half];
  if (rate > 0.0) return rate;
  const std::vector<char> from(half, 1);
  std::vector<char> to(half, 2);
  const int repeats = static_cast<int>(std::max<std::size_t>(1, (std::size_t{32} << 20) / half));
  for (int trial = 0; trial < kTrials; ++trial) {
    const double seconds = SecondsOf([&] {
      for (int i = 0; i < repeats; ++i) {
        std::memcpy(to.data(), from.data(), half);
        benchmark::DoNotOptimize(to.data());
        benchmark::ClobberMemory();
      }
    });
    rate = std::max(rate, 2.0 * static_cast<double>(half) * repeats / seconds);
  }
  return rate;
}

void Judge(benchmark::State& state, const Work& work, double seconds) {
  const double copy_s = work.bytes / CopyBytesPerSecond(static_cast<std::size_t>(work.bytes));
  const double floor_s = std::max(work.flops / PeakFlopsPerSecond(), copy_s);
  state.counters["MFLOP"] = work.flops / 1e6;
  state.counters["MB"] = work.bytes / 1e6;
  state.counters["GFLOP/s"] = work.flops / seconds / 1e9;
  state.counters["floor_ms"] = 1e3 * floor_s;
  state.counters["part_of_floor"] = floor_s / seconds;
  state.counters["times_memcpy"] = seconds / copy_s;
}

}  // namespace trem::bench
#endif  // HWY_ONCE
