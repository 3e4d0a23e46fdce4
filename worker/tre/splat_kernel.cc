#include "worker/tre/splat_kernel.h"

#include <algorithm>
#include <cmath>

#include "worker/sensor/bicubic.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/tre/splat_kernel.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

#if HWY_TARGET == HWY_SCALAR

// For processors without vectors of four floats: one pixel after the other.
void SplatTarget(const SplatRow& row, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes) {
  for (int u = row.begin; u < row.end; ++u) {
    const double depth = row.depth + u * row.d_depth;
    if (!(depth > 0.0)) continue;
    const double x = (row.x + u * row.dx) / depth;
    const double y = (row.y + u * row.dy) / depth;
    const float trust = row.weights != nullptr ? row.weights[u] : 1.0F;
    if (std::isnan(row.pixels[u]) || !(trust > 0.0F) || !CubicSupported(*planes.prediction, x, y)) continue;
    const int cx = static_cast<int>(x + 0.5);
    const int cy = static_cast<int>(y + 0.5);
    if (cy < row_begin || cy >= row_end) continue;
    const float difference = (row.pixels[u] - model.offset) / model.gain - SampleCubic(*planes.prediction, x, y);
    const float size = std::abs(model.gain * difference);
    const float robust = planes.seen->at(cx, cy) >= 1.5F && size > model.limit ? model.limit / size : 1.0F;
    const float weight = trust * robust * model.gain * model.gain;
    planes.weight->at(cx, cy) += weight;
    planes.weighted->at(cx, cy) += weight * (difference + planes.prediction->at(cx, cy));
  }
}

#else

constexpr std::size_t kPixels = 4;
using D4 = hn::FixedTag<float, kPixels>;
using V4 = hn::Vec<D4>;

// Whole cells and the fraction beyond them, per pixel.
struct Places {
  HWY_ALIGN float whole[kPixels];
  V4 fraction;
};

// Places are clamped to this; beyond any buffer and within an int.
constexpr double kFar = 1e6;

// Places of the four pixels from `u` on, relative to the whole cell that is returned: that of the first, split off in double precision, so
// that the fraction is as good as a float can be however large the buffer is.
HWY_INLINE int Locate(const SplatRow& row, int u, double start, double step, Places* places) {
  const D4 d;
  double at = start + u * step;
  V4 local;
  double base;
  if (row.d_depth == 0.0) {
    at /= row.depth;
    base = std::floor(std::clamp(at, -kFar, kFar));
    local = hn::MulAdd(hn::Set(d, static_cast<float>(step / row.depth)), hn::Iota(d, 0.0F), hn::Set(d, static_cast<float>(at - base)));
  } else {
    double places_of[kPixels];
    for (std::size_t i = 0; i < kPixels; ++i) {
      const int pixel = u + static_cast<int>(i);
      const double depth = row.depth + pixel * row.d_depth;
      places_of[i] = depth > 0.0 ? std::clamp((start + pixel * step) / depth, -kFar, kFar) : -kFar;
    }
    base = std::floor(places_of[0]);
    HWY_ALIGN float relative[kPixels];
    for (std::size_t i = 0; i < kPixels; ++i) relative[i] = static_cast<float>(places_of[i] - base);
    local = hn::Load(d, relative);
  }
  local = hn::Min(hn::Max(local, hn::Set(d, -2.0F * static_cast<float>(kFar))), hn::Set(d, 2.0F * static_cast<float>(kFar)));
  const V4 whole = hn::Floor(local);
  hn::Store(whole, d, places->whole);
  places->fraction = hn::Sub(local, whole);
  return static_cast<int>(base);
}

// Keys' weights (see worker/sensor/bicubic.h) of the cells at -1, 0, 1, 2.
HWY_INLINE void CubicWeights4(V4 t, V4* w) {
  const D4 d;
  const auto c = [&](float value) HWY_ATTR { return hn::Set(d, value); };
  const V4 t2 = hn::Mul(t, t);
  w[0] = hn::Mul(t, hn::MulAdd(hn::MulAdd(c(-0.5F), t, c(1.0F)), t, c(-0.5F)));
  w[1] = hn::MulAdd(hn::MulAdd(c(1.5F), t, c(-2.5F)), t2, c(1.0F));
  w[2] = hn::Mul(t, hn::MulAdd(hn::MulAdd(c(-1.5F), t, c(2.0F)), t, c(0.5F)));
  w[3] = hn::Mul(t2, hn::MulAdd(c(0.5F), t, c(-0.5F)));
}

// sum_i x_weights[i] * rows[pixel][i], per pixel.
HWY_INLINE V4 WeighAcross(const V4* rows, const V4* x_weights) {
  const D4 d;
  const V4 low01 = hn::InterleaveLower(d, rows[0], rows[1]);
  const V4 low23 = hn::InterleaveLower(d, rows[2], rows[3]);
  const V4 high01 = hn::InterleaveUpper(d, rows[0], rows[1]);
  const V4 high23 = hn::InterleaveUpper(d, rows[2], rows[3]);
  // Two interleaved floats of each pixel are one unit of 64 bits.
  V4 sum = hn::Mul(x_weights[0], hn::ConcatLowerLower(d, low23, low01));
  sum = hn::MulAdd(x_weights[1], hn::ConcatUpperUpper(d, low23, low01), sum);
  sum = hn::MulAdd(x_weights[2], hn::ConcatLowerLower(d, high23, high01), sum);
  return hn::MulAdd(x_weights[3], hn::ConcatUpperUpper(d, high23, high01), sum);
}

HWY_INLINE void SplatFour(const SplatRow& row, int u, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes) {
  const D4 d;
  const int width = planes.prediction->width();
  const int height = planes.prediction->height();
  Places px;
  Places py;
  const int x_base = Locate(row, u, row.x, row.dx, &px);
  const int y_base = Locate(row, u, row.y, row.dy, &py);
  HWY_ALIGN float x_round[kPixels];
  HWY_ALIGN float y_round[kPixels];
  const V4 half = hn::Set(d, 0.5F);
  hn::Store(hn::IfThenElseZero(hn::Ge(px.fraction, half), hn::Set(d, 1.0F)), d, x_round);
  hn::Store(hn::IfThenElseZero(hn::Ge(py.fraction, half), hn::Set(d, 1.0F)), d, y_round);
  V4 x_weights[4];
  V4 y_weights[4];
  CubicWeights4(px.fraction, x_weights);
  CubicWeights4(py.fraction, y_weights);
  HWY_ALIGN float wy[4][kPixels];
  for (std::size_t j = 0; j < 4; ++j) hn::Store(y_weights[j], d, wy[j]);

  const std::size_t count = std::min(kPixels, static_cast<std::size_t>(row.end - u));
  std::size_t cell[kPixels] = {};
  bool used[kPixels] = {};
  bool any = false;
  HWY_ALIGN float centre[kPixels] = {};
  HWY_ALIGN float seen[kPixels] = {};
  V4 rows[kPixels] = {hn::Zero(d), hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  for (std::size_t i = 0; i < count; ++i) {
    const int ix = x_base + static_cast<int>(px.whole[i]);
    const int iy = y_base + static_cast<int>(py.whole[i]);
    const int cy = iy + static_cast<int>(y_round[i]);
    const bool supported = ix >= 1 && iy >= 1 && ix < width - 2 && iy < height - 2;
    if (!supported || cy < row_begin || cy >= row_end) continue;
    if (std::isnan(row.pixels[u + static_cast<int>(i)])) continue;
    if (row.weights != nullptr && !(row.weights[u + static_cast<int>(i)] > 0.0F)) continue;
    const float* p = planes.prediction->row(iy - 1) + ix - 1;
    V4 sum = hn::Mul(hn::Set(d, wy[0][i]), hn::LoadU(d, p));
    sum = hn::MulAdd(hn::Set(d, wy[1][i]), hn::LoadU(d, p + width), sum);
    sum = hn::MulAdd(hn::Set(d, wy[2][i]), hn::LoadU(d, p + 2 * static_cast<std::ptrdiff_t>(width)), sum);
    rows[i] = hn::MulAdd(hn::Set(d, wy[3][i]), hn::LoadU(d, p + 3 * static_cast<std::ptrdiff_t>(width)), sum);
    cell[i] = static_cast<std::size_t>(cy) * static_cast<std::size_t>(width) + static_cast<std::size_t>(ix + static_cast<int>(x_round[i]));
    centre[i] = planes.prediction->row(0)[cell[i]];
    seen[i] = planes.seen->row(0)[cell[i]];
    used[i] = any = true;
  }
  if (!any) return;

  const V4 predicted = WeighAcross(rows, x_weights);
  const V4 gain = hn::Set(d, model.gain);
  const V4 limit = hn::Set(d, model.limit);
  const V4 one = hn::Set(d, 1.0F);
  const V4 value = hn::Div(hn::Sub(LoadUpTo(d, row.pixels + u, count), hn::Set(d, model.offset)), gain);
  const V4 difference = hn::Sub(value, predicted);
  const V4 size = hn::Abs(hn::Mul(gain, difference));
  // The first look at a cell has nothing to be an outlier of.
  const auto outlier = hn::And(hn::Ge(hn::Load(d, seen), hn::Set(d, 1.5F)), hn::Gt(size, limit));
  const V4 robust = hn::IfThenElse(outlier, hn::Div(limit, size), one);
  const V4 trust = row.weights != nullptr ? LoadUpTo(d, row.weights + u, count) : one;
  const V4 weight = hn::Mul(hn::Mul(trust, robust), hn::Mul(gain, gain));
  const V4 weighted = hn::Mul(weight, hn::Add(difference, hn::Load(d, centre)));
  HWY_ALIGN float added_weight[kPixels];
  HWY_ALIGN float added_weighted[kPixels];
  hn::Store(weight, d, added_weight);
  hn::Store(weighted, d, added_weighted);
  for (std::size_t i = 0; i < count; ++i) {
    if (!used[i]) continue;
    planes.weight->row(0)[cell[i]] += added_weight[i];
    planes.weighted->row(0)[cell[i]] += added_weighted[i];
  }
}

void SplatTarget(const SplatRow& row, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes) {
  for (int u = row.begin; u < row.end; u += static_cast<int>(kPixels)) SplatFour(row, u, model, row_begin, row_end, planes);
}

#endif  // HWY_TARGET == HWY_SCALAR

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
