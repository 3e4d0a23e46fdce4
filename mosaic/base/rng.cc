#include "mosaic/base/rng.h"

#include <cmath>
#include <numbers>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// SplitMix64 finaliser: spreads the words of a stream's name over the 64-bit key.
std::uint64_t Mix(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

}  // namespace

Rng::Rng(std::initializer_list<std::uint64_t> key) {
  std::uint64_t a = 0x243f6a8885a308d3ULL;
  std::uint64_t b = 0x13198a2e03707344ULL;
  for (const std::uint64_t word : key) {
    a = Mix(a ^ word);
    b = Mix(b + a);
  }
  key_ = {static_cast<std::uint32_t>(a), static_cast<std::uint32_t>(a >> 32)};
  counter_[2] = static_cast<std::uint32_t>(b);
  counter_[3] = static_cast<std::uint32_t>(b >> 32);
}

void Rng::Refill() {
  std::array<std::uint32_t, 4> x = counter_;
  std::array<std::uint32_t, 2> k = key_;
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t p0 = 0xD2511F53ULL * x[0];
    const std::uint64_t p1 = 0xCD9E8D57ULL * x[2];
    x = {static_cast<std::uint32_t>(p1 >> 32) ^ x[1] ^ k[0], static_cast<std::uint32_t>(p1),
         static_cast<std::uint32_t>(p0 >> 32) ^ x[3] ^ k[1], static_cast<std::uint32_t>(p0)};
    k[0] += 0x9E3779B9U;
    k[1] += 0xBB67AE85U;
  }
  block_ = x;
  used_ = 0;
  if (++counter_[0] == 0) ++counter_[1];
}

Rng::result_type Rng::operator()() {
  if (used_ == 4) Refill();
  return block_[static_cast<std::size_t>(used_++)];
}

double Rng::Uniform() {
  const std::uint64_t high = (*this)() >> 5;
  const std::uint64_t low = (*this)() >> 6;
  return static_cast<double>((high << 26) | low) * 0x1.0p-53;
}

std::uint32_t Rng::UniformIndex(std::uint32_t bound) {
  TREM_CHECK(bound > 0);
  const std::uint32_t threshold = static_cast<std::uint32_t>(-bound) % bound;
  for (;;) {
    const std::uint32_t x = (*this)();
    if (x >= threshold) return x % bound;
  }
}

double Rng::Normal() {
  if (has_spare_) {
    has_spare_ = false;
    return spare_;
  }
  const double u = 1.0 - Uniform();  // (0, 1]: the logarithm stays finite.
  const double radius = std::sqrt(-2.0 * std::log(u));
  const double angle = 2.0 * std::numbers::pi * Uniform();
  spare_ = radius * std::sin(angle);
  has_spare_ = true;
  return radius * std::cos(angle);
}

}  // namespace trem
