#pragma once

#include <benchmark/benchmark.h>

#include <cstddef>

namespace trem::bench {

// What one core of this machine can do, in CPU time, measured in the same run as the benchmark that is judged by it.

// Floating-point operations per second (a fused multiply-add counts as two) of a loop of independent multiply-adds in registers, on the
// best SIMD target. Measured once.
double PeakFlopsPerSecond();

// Bytes per second, read and written together, of a memcpy that moves `moved_bytes` (half of them read, half written). Measured once for
// each size, so that it runs in the level of the memory hierarchy that such an amount of data lives in.
double CopyBytesPerSecond(std::size_t moved_bytes);

// The work of one iteration of a benchmark, counted by formula.
struct Work {
  double flops = 0.0;
  double bytes = 0.0;  // That must be read and written if every plane is touched once.
};

// Sets counters: floor_ms (the larger of arithmetic at peak and a memcpy of the bytes: the roofline), part_of_floor (floor over measured
// time) and times_memcpy (measured time over that of the memcpy). `seconds` is the measured time of one iteration.
void Judge(benchmark::State& state, const Work& work, double seconds);

}  // namespace trem::bench
