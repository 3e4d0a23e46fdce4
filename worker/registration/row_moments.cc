#include "worker/registration/row_moments.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/registration/row_moments.cc"
#include <hwy/foreach_target.h>
// After foreach_target.
#include "worker/sensor/bicubic-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sums run in 16 lanes on every target: lane k holds pixels k, k + 16, ...
constexpr int kLanes = 16;
// Pixels beyond are no measurement: infinite ones would make a weight of 0 times infinity.
constexpr float kPixelMax = 1e18F;
using Lanes = hn::CappedTag<float, kLanes>;
#if HWY_TARGET != HWY_SCALAR
using Four = hn::FixedTag<float, 4>;
#endif
using V = hn::Vec<Lanes>;

// Where each pixel falls in the prediction, its bicubic weights along y, and what is known of it. Source of the weights: Keys 1981, as
// in worker/sensor/bicubic.h.
HWY_ATTR void Locate(const MomentRow& row, MomentScratch* s) {
  const Lanes d;
  const hn::RebindToSigned<Lanes> di;
  const auto one = hn::Set(d, 1.0F);
  const auto half = hn::Set(d, 0.5F);
  const auto three_halves = hn::Set(d, 1.5F);
  const auto stride = hn::Set(di, static_cast<int>(row.stride));
  const int step = static_cast<int>(hn::Lanes(d));
  for (int i = 0; i < row.count; i += step) {
    const auto k = hn::Iota(d, static_cast<float>(i));
    const auto depth = hn::Add(hn::Set(d, row.d0), hn::Mul(hn::Set(d, row.d1), k));
    const auto x = hn::Div(hn::Add(hn::Set(d, row.nx0), hn::Mul(hn::Set(d, row.nx1), k)), depth);
    const auto y = hn::Div(hn::Add(hn::Set(d, row.ny0), hn::Mul(hn::Set(d, row.ny1), k)), depth);
    const auto inside = hn::And(hn::And(hn::And(hn::Ge(x, hn::Set(d, row.x_min)), hn::Lt(x, hn::Set(d, row.x_max))),
                                        hn::And(hn::Ge(y, hn::Set(d, row.y_min)), hn::Lt(y, hn::Set(d, row.y_max)))),
                                hn::And(hn::Gt(depth, hn::Set(d, 1e-3F)), hn::Lt(k, hn::Set(d, static_cast<float>(row.count)))));
    const auto ix = hn::Floor(x);
    const auto iy = hn::Floor(y);
    const auto tx = hn::Sub(x, ix);
    const auto ty = hn::Sub(y, iy);
    // Outside, the support at the nearest end of the image is read and given no weight.
    const auto inside_i = hn::RebindMask(di, inside);
    const auto first = hn::Add(hn::Mul(hn::ConvertTo(di, hn::IfThenElse(inside, iy, hn::Set(d, row.y_min))), stride),
                               hn::ConvertTo(di, hn::IfThenElse(inside, ix, hn::Set(d, row.x_min))));
    hn::StoreU(hn::Sub(first, hn::Add(stride, hn::Set(di, 1))), di, s->index.data() + i);
    const auto nearest = hn::Add(hn::IfThenElseZero(hn::Ge(tx, half), one),
                                 hn::IfThenElseZero(hn::Ge(ty, half), hn::Set(d, static_cast<float>(row.stride))));
    const auto seen_at = hn::Add(first, hn::IfThenElseZero(inside_i, hn::ConvertTo(di, nearest)));
    hn::StoreU(seen_at, di, s->nearest.data() + i);
    hn::StoreU(hn::IfThenElseZero(inside, hn::LoadU(d, s->trust.data() + i)), d, s->trust.data() + i);
    hn::StoreU(hn::IfThenElseZero(inside, tx), d, s->x_fraction.data() + i);
    const auto t = hn::IfThenElseZero(inside, ty);
    const auto t2 = hn::Mul(t, t);
    const auto t3 = hn::Mul(t2, t);
    hn::StoreInterleaved4(hn::Sub(t2, hn::Mul(half, hn::Add(t3, t))),
                          hn::Add(hn::Sub(hn::Mul(three_halves, t3), hn::Mul(hn::Set(d, 2.5F), t2)), one),
                          hn::Add(hn::Sub(hn::Mul(hn::Set(d, 2.0F), t2), hn::Mul(three_halves, t3)), hn::Mul(half, t)),
                          hn::Mul(half, hn::Sub(t3, t2)), d, s->y_weights.data() + 4 * i);
    hn::StoreInterleaved4(hn::Sub(hn::Sub(hn::Mul(hn::Set(d, 2.0F), t), hn::Mul(three_halves, t2)), half),
                          hn::Sub(hn::Mul(hn::Set(d, 4.5F), t2), hn::Mul(hn::Set(d, 5.0F), t)),
                          hn::Add(hn::Sub(hn::Mul(hn::Set(d, 4.0F), t), hn::Mul(hn::Set(d, 4.5F), t2)), half),
                          hn::Sub(hn::Mul(three_halves, t2), t), d, s->y_slopes.data() + 4 * i);
  }
}

// Combines the four rows of every pixel's support along y: values and slopes of its four columns. Fetches the frames that have seen it.
HWY_ATTR void CombineRows(const MomentRow& row, MomentScratch* s) {
#if HWY_TARGET == HWY_SCALAR
  for (int i = 0; i < row.count; ++i) s->seen[static_cast<std::size_t>(i)] = row.seen[s->nearest[static_cast<std::size_t>(i)]];
  for (int i = 0; i < 4 * row.count; ++i) {
    const float* p = row.prediction + s->index[static_cast<std::size_t>(i / 4)] + i % 4;
    const float* w = s->y_weights.data() + i / 4 * 4;
    const float* g = s->y_slopes.data() + i / 4 * 4;
    s->values[static_cast<std::size_t>(i)] = (w[0] * p[0] + w[1] * p[row.stride]) + (w[2] * p[2 * row.stride] + w[3] * p[3 * row.stride]);
    s->slopes[static_cast<std::size_t>(i)] = (g[0] * p[0] + g[1] * p[row.stride]) + (g[2] * p[2 * row.stride] + g[3] * p[3 * row.stride]);
  }
#else
  const Supports d;
  for (int i = 0; i < row.count; ++i) s->seen[static_cast<std::size_t>(i)] = row.seen[s->nearest[static_cast<std::size_t>(i)]];
  // Beyond the last pixel Locate has put places inside the image.
  for (int i = 0; i < row.count; i += kSupports) {
    const int* const first = s->index.data() + i;
    const auto w = hn::LoadU(d, s->y_weights.data() + 4 * i);
    const auto g = hn::LoadU(d, s->y_slopes.data() + 4 * i);
    const auto a = LoadSupports(d, row.prediction, first);
    const auto b = LoadSupports(d, row.prediction + row.stride, first);
    const auto c = LoadSupports(d, row.prediction + 2 * row.stride, first);
    const auto e = LoadSupports(d, row.prediction + 3 * row.stride, first);
    const auto value = hn::Add(hn::Add(hn::Mul(hn::Broadcast<0>(w), a), hn::Mul(hn::Broadcast<1>(w), b)),
                               hn::Add(hn::Mul(hn::Broadcast<2>(w), c), hn::Mul(hn::Broadcast<3>(w), e)));
    const auto slope = hn::Add(hn::Add(hn::Mul(hn::Broadcast<0>(g), a), hn::Mul(hn::Broadcast<1>(g), b)),
                               hn::Add(hn::Mul(hn::Broadcast<2>(g), c), hn::Mul(hn::Broadcast<3>(g), e)));
    hn::StoreU(value, d, s->values.data() + 4 * i);
    hn::StoreU(slope, d, s->slopes.data() + 4 * i);
  }
#endif
}

// Adds the products of one group of lanes to sums[kMomentCount].
template <bool kProjective>
HWY_ATTR HWY_INLINE void AddProducts(const Lanes d, V w, V seen, V gx, V gy, V p, V r, V s, V* sums) {
  const auto add = [&](int moment, V product) HWY_ATTR { sums[moment] = hn::Add(sums[moment], product); };
  const V wx = hn::Mul(w, gx);
  const V wy = hn::Mul(w, gy);
  const V wp = hn::Mul(w, p);
  const V wr = hn::Mul(w, r);
  const V sx = hn::Mul(s, wx);
  const V sy = hn::Mul(s, wy);
  const V ssx = hn::Mul(s, sx);
  const V gxs = hn::Mul(gx, s);
  add(kXX, hn::Mul(wx, gx));
  add(kXX + 1, hn::Mul(sx, gx));
  add(kXX + 2, hn::Mul(sx, gxs));
  add(kXY, hn::Mul(wx, gy));
  add(kXY + 1, hn::Mul(sx, gy));
  add(kXY + 2, hn::Mul(ssx, gy));
  add(kYY, hn::Mul(wy, gy));
  add(kYY + 1, hn::Mul(sy, gy));
  add(kYY + 2, hn::Mul(hn::Mul(sy, s), gy));
  add(kXP, hn::Mul(wx, p));
  add(kXP + 1, hn::Mul(sx, p));
  add(kYP, hn::Mul(wy, p));
  add(kYP + 1, hn::Mul(sy, p));
  add(kX1, wx);
  add(kX1 + 1, sx);
  add(kY1, wy);
  add(kY1 + 1, sy);
  add(kXR, hn::Mul(wx, r));
  add(kXR + 1, hn::Mul(sx, r));
  add(kYR, hn::Mul(wy, r));
  add(kYR + 1, hn::Mul(sy, r));
  add(kPP, hn::Mul(wp, p));
  add(kP1, wp);
  add(k11, w);
  add(kPR, hn::Mul(wp, r));
  add(k1R, wr);
  add(kRR, hn::Mul(wr, r));
  add(kSeen, seen);
  add(kCount, hn::IfThenElseZero(hn::Gt(seen, hn::Zero(d)), hn::Set(d, 1.0F)));
  if (!kProjective) return;
  add(kXX + 3, hn::Mul(ssx, gxs));
  add(kXX + 4, hn::Mul(ssx, hn::Mul(gxs, s)));
  add(kXY + 3, hn::Mul(hn::Mul(ssx, s), gy));
  add(kXP + 2, hn::Mul(ssx, p));
  add(kX1 + 2, ssx);
  add(kXR + 2, hn::Mul(ssx, r));
}

template <bool kProjective>
HWY_ATTR void Accumulate(const MomentRow& row, MomentScratch* scratch, float* lanes) {
  const Lanes d;
  const int step = static_cast<int>(hn::Lanes(d));
  const auto half = hn::Set(d, 0.5F);
  const auto three_halves = hn::Set(d, 1.5F);
  const auto one = hn::Set(d, 1.0F);
  for (int group = 0; group < kLanes; group += step) {
    V sums[kMomentCount];
    for (V& sum : sums) sum = hn::Zero(d);
    for (int i = group; i < row.count; i += kLanes) {
      const V t = hn::LoadU(d, scratch->x_fraction.data() + i);
      const V t2 = hn::Mul(t, t);
      const V t3 = hn::Mul(t2, t);
      const V w0 = hn::Sub(t2, hn::Mul(half, hn::Add(t3, t)));
      const V w1 = hn::Add(hn::Sub(hn::Mul(three_halves, t3), hn::Mul(hn::Set(d, 2.5F), t2)), one);
      const V w2 = hn::Add(hn::Sub(hn::Mul(hn::Set(d, 2.0F), t2), hn::Mul(three_halves, t3)), hn::Mul(half, t));
      const V w3 = hn::Mul(half, hn::Sub(t3, t2));
      const V g0 = hn::Sub(hn::Sub(hn::Mul(hn::Set(d, 2.0F), t), hn::Mul(three_halves, t2)), half);
      const V g1 = hn::Sub(hn::Mul(hn::Set(d, 4.5F), t2), hn::Mul(hn::Set(d, 5.0F), t));
      const V g2 = hn::Add(hn::Sub(hn::Mul(hn::Set(d, 4.0F), t), hn::Mul(hn::Set(d, 4.5F), t2)), half);
      const V g3 = hn::Sub(hn::Mul(three_halves, t2), t);
      V a, b, c, e;
      hn::LoadInterleaved4(d, scratch->slopes.data() + 4 * i, a, b, c, e);
      const V dy = hn::Add(hn::Add(hn::Mul(w0, a), hn::Mul(w1, b)), hn::Add(hn::Mul(w2, c), hn::Mul(w3, e)));
      hn::LoadInterleaved4(d, scratch->values.data() + 4 * i, a, b, c, e);
      const V p = hn::Add(hn::Add(hn::Mul(w0, a), hn::Mul(w1, b)), hn::Add(hn::Mul(w2, c), hn::Mul(w3, e)));
      const V dx = hn::Add(hn::Add(hn::Mul(g0, a), hn::Mul(g1, b)), hn::Add(hn::Mul(g2, c), hn::Mul(g3, e)));
      const V k = hn::Iota(d, static_cast<float>(i));
      V gx, gy;
      if (kProjective) {
        const V inverse = hn::Div(one, hn::Add(hn::Set(d, row.d0), hn::Mul(hn::Set(d, row.d1), k)));
        const V x = hn::Mul(inverse, hn::Add(hn::Set(d, row.nx0), hn::Mul(hn::Set(d, row.nx1), k)));
        const V y = hn::Mul(inverse, hn::Add(hn::Set(d, row.ny0), hn::Mul(hn::Set(d, row.ny1), k)));
        gx = hn::Mul(inverse, hn::Add(hn::Mul(dx, hn::Sub(hn::Set(d, row.ax), hn::Mul(x, hn::Set(d, row.bx)))),
                                      hn::Mul(dy, hn::Sub(hn::Set(d, row.ay), hn::Mul(y, hn::Set(d, row.bx))))));
        gy = hn::Mul(inverse, hn::Add(hn::Mul(dx, hn::Sub(hn::Set(d, row.cx), hn::Mul(x, hn::Set(d, row.by)))),
                                      hn::Mul(dy, hn::Sub(hn::Set(d, row.cy), hn::Mul(y, hn::Set(d, row.by))))));
      } else {
        gx = hn::Add(hn::Mul(dx, hn::Set(d, row.ax)), hn::Mul(dy, hn::Set(d, row.ay)));
        gy = hn::Add(hn::Mul(dx, hn::Set(d, row.cx)), hn::Mul(dy, hn::Set(d, row.cy)));
      }
      const V n = hn::LoadU(d, scratch->seen.data() + i);
      const V pixel = hn::LoadU(d, scratch->pixel.data() + i);
      const V trust = hn::Mul(hn::LoadU(d, scratch->trust.data() + i), hn::Div(n, hn::Add(n, one)));
      const auto used =
          hn::And(hn::And(hn::Gt(trust, hn::Zero(d)), hn::Ge(n, hn::Set(d, row.seen_min))), hn::Lt(hn::Abs(pixel), hn::Set(d, kPixelMax)));
      const V seen = hn::IfThenElseZero(used, trust);
      const V intensity = hn::IfThenElseZero(used, pixel);
      const V r = hn::Sub(hn::Sub(intensity, hn::Mul(hn::Set(d, row.gain), p)), hn::Set(d, row.offset));
      const V magnitude = hn::Abs(r);
      const V robust = hn::Min(one, hn::Div(hn::Set(d, row.huber), hn::Max(magnitude, hn::Set(d, 1e-20F))));
      const V w = hn::IfThenElseZero(used, hn::Mul(seen, robust));
      const V s = hn::Add(hn::Set(d, row.s0), hn::Mul(hn::Set(d, row.s1), k));
      hn::StoreU(hn::IfThenElse(used, magnitude, hn::Set(d, -1.0F)), d, scratch->residual.data() + i);
      // Unused pixels have read some place of the image: finite or not, they must not count.
      AddProducts<kProjective>(d, w, seen, hn::IfThenElseZero(used, gx), hn::IfThenElseZero(used, gy), hn::IfThenElseZero(used, p),
                               hn::IfThenElseZero(used, r), s, sums);
    }
    for (int m = 0; m < kMomentCount; ++m) hn::StoreU(sums[m], d, lanes + m * kLanes + group);
  }
}

// The 16 lanes of each moment, folded in a fixed order: k = 0 .. 3 each ((k + (k + 4)) + ((k + 8) + (k + 12))), these as (0 + 2) + (1 + 3).
HWY_ATTR void Fold(const float* lanes, float* moments) {
#if HWY_TARGET == HWY_SCALAR
  for (int m = 0; m < kMomentCount; ++m) {
    const float* own = lanes + m * kLanes;
    const auto fourth = [own](int k) { return (own[k] + own[k + 4]) + (own[k + 8] + own[k + 12]); };
    moments[m] = (fourth(0) + fourth(2)) + (fourth(1) + fourth(3));
  }
#else
  static_assert(kMomentCount % 4 == 0, "four moments at a time");
  const Four d;
  HWY_ALIGN float folded[4 * 4];
  for (int m = 0; m < kMomentCount; m += 4) {
    for (int j = 0; j < 4; ++j) {
      const float* own = lanes + (m + j) * kLanes;
      const auto low = hn::Add(hn::LoadU(d, own), hn::LoadU(d, own + 4));
      const auto high = hn::Add(hn::LoadU(d, own + 8), hn::LoadU(d, own + 12));
      hn::Store(hn::Add(low, high), d, folded + 4 * j);
    }
    hn::Vec<Four> a, b, c, e;
    hn::LoadInterleaved4(d, folded, a, b, c, e);
    hn::StoreU(hn::Add(hn::Add(a, c), hn::Add(b, e)), d, moments + m);
  }
#endif
}

HWY_ATTR void RowMomentsTarget(const MomentRow& row, bool projective, MomentScratch* scratch, float* moments) {
  Locate(row, scratch);
  CombineRows(row, scratch);
  float lanes[kMomentCount * kLanes];
  if (projective) {
    Accumulate<true>(row, scratch, lanes);
  } else {
    Accumulate<false>(row, scratch, lanes);
  }
  Fold(lanes, moments);
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(RowMomentsTarget);

void MomentScratch::Reserve(int count) {
  const auto padded = static_cast<std::size_t>((count + 31) / 16 * 16);
  for (std::vector<float>* plane : {&x_fraction, &seen, &pixel, &trust, &residual}) plane->resize(padded);
  for (std::vector<float>* plane : {&y_weights, &y_slopes, &values, &slopes}) plane->resize(4 * padded);
  index.resize(padded);
  nearest.resize(padded);
}

void RowMoments(const MomentRow& row, bool projective, MomentScratch* scratch, float* moments) {
  scratch->Reserve(row.count);
  const auto gather = [&row](const float* from, float* to) {
    if (row.pixel_step == 1) {
      std::copy(from, from + row.count, to);
    } else {
      for (int i = 0; i < row.count; ++i) to[i] = from[i * row.pixel_step];
    }
  };
  gather(row.pixels, scratch->pixel.data());
  if (row.weights != nullptr) {
    gather(row.weights, scratch->trust.data());
  } else {
    std::fill_n(scratch->trust.begin(), row.count, 1.0F);
  }
  HWY_DYNAMIC_DISPATCH(RowMomentsTarget)(row, projective, scratch, moments);
}

}  // namespace trem
#endif  // HWY_ONCE
