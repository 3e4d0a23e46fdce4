#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>

namespace trem {

// A counter-based random stream: Philox 4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).
//
// A stream is named by a key, for example {seed, window, frame}. Streams with different keys are independent, so the numbers a task
// draws depend on what it computes and never on which thread or worker computes it. Satisfies UniformRandomBitGenerator.
class Rng {
 public:
  using result_type = std::uint32_t;

  explicit Rng(std::initializer_list<std::uint64_t> key);

  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return 0xffffffffU; }
  result_type operator()();

  // Uniform in [0, 1), 53 bits.
  double Uniform();
  // Uniform integer in [0, bound); bound > 0. Unbiased (rejection).
  std::uint32_t UniformIndex(std::uint32_t bound);
  // Standard normal (Box-Muller; the standard library's distributions differ between implementations).
  double Normal();

 private:
  void Refill();

  std::array<std::uint32_t, 2> key_{};
  std::array<std::uint32_t, 4> counter_{};
  std::array<std::uint32_t, 4> block_{};
  int used_ = 4;
  bool has_spare_ = false;
  double spare_ = 0.0;
};

}  // namespace trem
