#include "worker/tre/splat_kernel.h"

#include <algorithm>
#include <cmath>

#include "worker/sensor/bicubic.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/tre/splat_kernel.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/bicubic-inl.h"
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

// Pixels that are taken together, and of them those whose places are relative to one whole cell.
constexpr int kChunk = 64;
constexpr int kGroup = 16;
using Lanes = hn::CappedTag<float, kGroup>;
using V = hn::Vec<Lanes>;

// Places are clamped to this; beyond any buffer and within an int.
constexpr double kFar = 1e6;

// A chunk of a row's pixels, one pass after the other: what is a vector operation is done for many pixels at once.
struct Chunk {
  HWY_ALIGN float x_fraction[kChunk];
  HWY_ALIGN float y_weights[4 * kChunk];  // 4 a pixel.
  HWY_ALIGN float columns[4 * kChunk];    // 4 a pixel: columns of the support combined along y.
  HWY_ALIGN int first[kChunk];            // Index of the support's first cell; of some cell where the pixel is not used.
  HWY_ALIGN int cell[kChunk];             // Of the nearest cell; -1: not used.
  HWY_ALIGN float centre[kChunk];         // Prediction there.
  HWY_ALIGN float seen[kChunk];
  HWY_ALIGN float weight[kChunk];
  HWY_ALIGN float weighted[kChunk];
};

// Places of the pixels of the group at `u`, relative to the whole cell that is returned: that of the first, split off in double precision,
// so that the fraction is as good as a float can be however large the buffer is.
HWY_INLINE int Locate(const SplatRow& row, int u, double start, double step, float* local) {
  const Lanes d;
  double at = start + u * step;
  double base;
  if (row.d_depth == 0.0) {
    at /= row.depth;
    base = std::floor(std::clamp(at, -kFar, kFar));
    const V each = hn::Set(d, static_cast<float>(step / row.depth));
    const V first = hn::Set(d, static_cast<float>(at - base));
    for (int i = 0; i < kGroup; i += static_cast<int>(hn::Lanes(d))) {
      hn::Store(hn::MulAdd(each, hn::Iota(d, static_cast<float>(i)), first), d, local + i);
    }
  } else {
    double places[kGroup];
    for (int i = 0; i < kGroup; ++i) {
      const double depth = row.depth + (u + i) * row.d_depth;
      places[i] = depth > 0.0 ? std::clamp((start + (u + i) * step) / depth, -kFar, kFar) : -kFar;
    }
    base = std::floor(places[0]);
    for (int i = 0; i < kGroup; ++i) local[i] = static_cast<float>(places[i] - base);
  }
  return static_cast<int>(base);
}

// Keys' weights (see worker/sensor/bicubic.h) of the cells at -1, 0, 1, 2.
HWY_INLINE void CubicWeightsOf(V t, V* w) {
  const Lanes d;
  const auto c = [&](float value) HWY_ATTR { return hn::Set(d, value); };
  const V t2 = hn::Mul(t, t);
  w[0] = hn::Mul(t, hn::MulAdd(hn::MulAdd(c(-0.5F), t, c(1.0F)), t, c(-0.5F)));
  w[1] = hn::MulAdd(hn::MulAdd(c(1.5F), t, c(-2.5F)), t2, c(1.0F));
  w[2] = hn::Mul(t, hn::MulAdd(hn::MulAdd(c(-1.5F), t, c(2.0F)), t, c(0.5F)));
  w[3] = hn::Mul(t2, hn::MulAdd(c(0.5F), t, c(-0.5F)));
}

// Where `count` pixels from `u` on fall, and which of them are used.
HWY_INLINE void PlaceGroup(const SplatRow& row, int u, int count, int row_begin, int row_end, int width, int height, int at, Chunk* chunk) {
  const Lanes d;
  const hn::RebindToSigned<Lanes> di;
  const auto integer = [&](int value) HWY_ATTR { return hn::Set(di, value); };
  HWY_ALIGN float x_local[kGroup];
  HWY_ALIGN float y_local[kGroup];
  const auto x_base = integer(Locate(row, u, row.x, row.dx, x_local));
  const auto y_base = integer(Locate(row, u, row.y, row.dy, y_local));
  const V far = hn::Set(d, 2.0F * static_cast<float>(kFar));
  const V half = hn::Set(d, 0.5F);
  const V zero = hn::Zero(d);
  for (int i = 0; i < kGroup; i += static_cast<int>(hn::Lanes(d))) {
    const V x = hn::Min(hn::Max(hn::Load(d, x_local + i), hn::Neg(far)), far);
    const V y = hn::Min(hn::Max(hn::Load(d, y_local + i), hn::Neg(far)), far);
    const V x_whole = hn::Floor(x);
    const V y_whole = hn::Floor(y);
    const V tx = hn::Sub(x, x_whole);
    const V ty = hn::Sub(y, y_whole);
    const auto ix = hn::Add(x_base, hn::ConvertTo(di, x_whole));
    const auto iy = hn::Add(y_base, hn::ConvertTo(di, y_whole));
    const auto one = integer(1);
    const auto cx = hn::Add(ix, hn::IfThenElseZero(hn::RebindMask(di, hn::Ge(tx, half)), one));
    const auto cy = hn::Add(iy, hn::IfThenElseZero(hn::RebindMask(di, hn::Ge(ty, half)), one));
    auto used = hn::And(hn::And(hn::Gt(ix, integer(0)), hn::Gt(iy, integer(0))),
                        hn::And(hn::Lt(ix, integer(width - 2)), hn::Lt(iy, integer(height - 2))));
    used = hn::And(used, hn::And(hn::Gt(cy, integer(row_begin - 1)), hn::Lt(cy, integer(row_end))));
    const std::size_t rest = static_cast<std::size_t>(std::max(count - i, 0));
    const V pixel = LoadUpTo(d, row.pixels + u + i, rest);
    V trust = hn::Set(d, 1.0F);
    if (row.weights != nullptr) trust = LoadUpTo(d, row.weights + u + i, rest);
    const auto measured = hn::And(hn::And(hn::Eq(pixel, pixel), hn::Gt(trust, zero)), hn::FirstN(d, rest));
    used = hn::And(used, hn::RebindMask(di, measured));
    const auto nowhere = integer(-1);
    hn::Store(hn::IfThenElse(used, hn::Add(hn::Mul(cy, integer(width)), cx), nowhere), di, chunk->cell + at + i);
    hn::Store(hn::IfThenElseZero(used, hn::Add(hn::Mul(hn::Sub(iy, one), integer(width)), hn::Sub(ix, one))), di, chunk->first + at + i);
    hn::Store(tx, d, chunk->x_fraction + at + i);
    V w[4];
    CubicWeightsOf(ty, w);
    hn::StoreInterleaved4(w[0], w[1], w[2], w[3], d, chunk->y_weights + 4 * (at + i));
  }
}

// Combines the rows of every pixel's support along y, and fetches what is at its cell.
HWY_INLINE void Fetch(const SplatPlanes& planes, int count, Chunk* chunk) {
  const float* const prediction = planes.prediction->row(0);
  const float* const seen = planes.seen->row(0);
  const std::ptrdiff_t width = planes.prediction->width();
#if HWY_TARGET == HWY_SCALAR
  for (int i = 0; i < 4 * count; ++i) {
    const float* p = prediction + chunk->first[i / 4] + i % 4;
    const float* w = chunk->y_weights + i / 4 * 4;
    chunk->columns[i] = ((w[0] * p[0] + w[1] * p[width]) + w[2] * p[2 * width]) + w[3] * p[3 * width];
  }
#else
  const Supports d;
  // Beyond the last pixel of a group the places are those of pixels that are not used.
  for (int i = 0; i < count; i += kSupports) {
    const int* const first = chunk->first + i;
    const auto w = hn::Load(d, chunk->y_weights + 4 * i);
    auto sum = hn::Mul(hn::Broadcast<0>(w), LoadSupports(d, prediction, first));
    sum = hn::MulAdd(hn::Broadcast<1>(w), LoadSupports(d, prediction + width, first), sum);
    sum = hn::MulAdd(hn::Broadcast<2>(w), LoadSupports(d, prediction + 2 * width, first), sum);
    hn::Store(hn::MulAdd(hn::Broadcast<3>(w), LoadSupports(d, prediction + 3 * width, first), sum), d, chunk->columns + 4 * i);
  }
#endif
  for (int i = 0; i < count; ++i) {
    const int cell = std::max(chunk->cell[i], 0);
    chunk->centre[i] = prediction[cell];
    chunk->seen[i] = seen[cell];
  }
}

// The weight of every pixel's sample, and that times its value at the cell.
HWY_INLINE void Weigh(const SplatRow& row, int u, int count, const SplatModel& model, Chunk* chunk) {
  const Lanes d;
  const V gain = hn::Set(d, model.gain);
  const V limit = hn::Set(d, model.limit);
  const V one = hn::Set(d, 1.0F);
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d))) {
    const std::size_t rest = static_cast<std::size_t>(count - i);
    V w[4];
    CubicWeightsOf(hn::Load(d, chunk->x_fraction + i), w);
    V c[4];
    hn::LoadInterleaved4(d, chunk->columns + 4 * i, c[0], c[1], c[2], c[3]);
    V predicted = hn::Mul(w[0], c[0]);
    for (int k = 1; k < 4; ++k) predicted = hn::MulAdd(w[k], c[k], predicted);
    const V value = hn::Div(hn::Sub(LoadUpTo(d, row.pixels + u + i, rest), hn::Set(d, model.offset)), gain);
    const V difference = hn::Sub(value, predicted);
    const V size = hn::Abs(hn::Mul(gain, difference));
    // The first look at a cell has nothing to be an outlier of.
    const auto outlier = hn::And(hn::Ge(hn::Load(d, chunk->seen + i), hn::Set(d, 1.5F)), hn::Gt(size, limit));
    const V robust = hn::IfThenElse(outlier, hn::Div(limit, size), one);
    const V trust = row.weights != nullptr ? LoadUpTo(d, row.weights + u + i, rest) : one;
    const V weight = hn::Mul(hn::Mul(trust, robust), hn::Mul(gain, gain));
    hn::Store(weight, d, chunk->weight + i);
    hn::Store(hn::Mul(weight, hn::Add(difference, hn::Load(d, chunk->centre + i))), d, chunk->weighted + i);
  }
}

void SplatTarget(const SplatRow& row, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes) {
  const int width = planes.prediction->width();
  const int height = planes.prediction->height();
  float* const weight = planes.weight->row(0);
  float* const weighted = planes.weighted->row(0);
  if (width < 4 || height < 4) return;
  Chunk chunk;
  for (int u = row.begin / kGroup * kGroup; u < row.end; u += kChunk) {
    const int count = std::min(kChunk, row.end - u);
    for (int at = 0; at < count; at += kGroup) {
      PlaceGroup(row, u + at, std::min(kGroup, count - at), row_begin, row_end, width, height, at, &chunk);
    }
    Fetch(planes, count, &chunk);
    Weigh(row, u, count, model, &chunk);
    for (int i = 0; i < count; ++i) {
      const int cell = chunk.cell[i];
      if (cell < 0) continue;
      weight[cell] += chunk.weight[i];
      weighted[cell] += chunk.weighted[i];
    }
  }
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(SplatTarget);

void Splat(const SplatRow& row, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes) {
  HWY_DYNAMIC_DISPATCH(SplatTarget)(row, model, row_begin, row_end, planes);
}

}  // namespace trem
#endif  // HWY_ONCE
