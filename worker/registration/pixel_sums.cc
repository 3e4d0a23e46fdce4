#include "worker/registration/pixel_sums.h"

#include <algorithm>
#include <cstdint>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/registration/pixel_sums.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Eight lanes on every instruction set: in one vector, or in several.
constexpr hn::CappedTag<float, kPixelBlock> kF;
constexpr std::size_t kLanes = hn::MaxLanes(kF);
constexpr std::size_t kVectors = kPixelBlock / kLanes;
// Pixels summed up in single precision before they are added to a double.
constexpr std::size_t kFlush = 64 * kPixelBlock;

using VF = hn::Vec<decltype(kF)>;

struct Cubic {
  VF w[4];
};

HWY_INLINE Cubic Weights(VF t) {
  const VF half = hn::Set(kF, 0.5F);
  const VF t2 = hn::Mul(t, t);
  const VF t3 = hn::Mul(t2, t);
  Cubic c;
  c.w[0] = hn::Sub(t2, hn::Mul(half, hn::Add(t3, t)));
  c.w[1] = hn::Add(hn::Sub(hn::Mul(hn::Set(kF, 1.5F), t3), hn::Mul(hn::Set(kF, 2.5F), t2)), hn::Set(kF, 1.0F));
  c.w[2] = hn::Add(hn::Sub(hn::Mul(hn::Set(kF, 2.0F), t2), hn::Mul(hn::Set(kF, 1.5F), t3)), hn::Mul(half, t));
  c.w[3] = hn::Mul(half, hn::Sub(t3, t2));
  return c;
}

void SampleImpl(const PredictionGrid& grid, const PixelMap& map, const PixelSpan& pixels, float* value, float* trust) {
  const hn::RebindToSigned<decltype(kF)> ki;
  const VF one = hn::Set(kF, 1.0F);
  const VF half = hn::Set(kF, 0.5F);
  const VF x_end = hn::Set(kF, static_cast<float>(grid.width - 2));
  const VF y_end = hn::Set(kF, static_cast<float>(grid.height - 2));
  const auto width = hn::Set(ki, grid.width);
  VF m[8];
  for (int k = 0; k < 8; ++k) m[k] = hn::Set(kF, map.m[k]);
  for (std::size_t i = 0; i < pixels.count; i += kLanes) {
    const VF x = hn::LoadU(kF, pixels.x + i);
    const VF y = hn::LoadU(kF, pixels.y + i);
    VF cx = hn::Add(hn::Add(hn::Mul(m[0], x), hn::Mul(m[1], y)), m[2]);
    VF cy = hn::Add(hn::Add(hn::Mul(m[3], x), hn::Mul(m[4], y)), m[5]);
    auto inside = hn::Ge(one, one);
    if (map.projective) {
      const VF w = hn::Add(hn::Add(hn::Mul(m[6], x), hn::Mul(m[7], y)), one);
      inside = hn::Gt(w, hn::Set(kF, 1e-6F));
      cx = hn::Div(cx, w);
      cy = hn::Div(cy, w);
    }
    inside = hn::And(inside, hn::And(hn::And(hn::Ge(cx, one), hn::Ge(cy, one)), hn::And(hn::Lt(cx, x_end), hn::Lt(cy, y_end))));
    if (hn::AllFalse(kF, inside)) {
      hn::StoreU(hn::Zero(kF), kF, value + i);
      hn::StoreU(hn::Zero(kF), kF, trust + i);
      continue;
    }
    cx = hn::IfThenElse(inside, cx, one);
    cy = hn::IfThenElse(inside, cy, one);
    const auto ix = hn::ConvertTo(ki, cx);
    const auto iy = hn::ConvertTo(ki, cy);
    const Cubic wx = Weights(hn::Sub(cx, hn::ConvertTo(kF, ix)));
    const Cubic wy = Weights(hn::Sub(cy, hn::ConvertTo(kF, iy)));
    auto index = hn::Add(hn::Mul(hn::Sub(iy, hn::Set(ki, 1)), width), hn::Sub(ix, hn::Set(ki, 1)));
    VF sum = hn::Zero(kF);
    for (int j = 0; j < 4; ++j) {
      const VF p0 = hn::GatherIndex(kF, grid.prediction, index);
      const VF p1 = hn::GatherIndex(kF, grid.prediction + 1, index);
      const VF p2 = hn::GatherIndex(kF, grid.prediction + 2, index);
      const VF p3 = hn::GatherIndex(kF, grid.prediction + 3, index);
      const VF row = hn::Add(hn::Add(hn::Mul(wx.w[0], p0), hn::Mul(wx.w[1], p1)), hn::Add(hn::Mul(wx.w[2], p2), hn::Mul(wx.w[3], p3)));
      sum = hn::Add(sum, hn::Mul(wy.w[j], row));
      index = hn::Add(index, width);
    }
    const auto nearest = hn::Add(hn::Mul(hn::ConvertTo(ki, hn::Add(cy, half)), width), hn::ConvertTo(ki, hn::Add(cx, half)));
    const VF n = hn::GatherIndex(kF, grid.seen, nearest);
    const auto usable = hn::And(inside, hn::Ge(n, hn::Set(kF, grid.seen_min)));
    const VF s = hn::Mul(hn::LoadU(kF, pixels.weight + i), hn::Div(n, hn::Add(n, one)));
    hn::StoreU(hn::IfThenElseZero(usable, sum), kF, value + i);
    hn::StoreU(hn::IfThenElseZero(usable, s), kF, trust + i);
  }
}

// Eight partial sums of one quantity.
struct Lanes {
  VF v[kVectors];
  HWY_INLINE void Clear() {
    for (std::size_t k = 0; k < kVectors; ++k) v[k] = hn::Zero(kF);
  }
  HWY_INLINE void Flush(double* total) {
    HWY_ALIGN float lane[kPixelBlock];
    for (std::size_t k = 0; k < kVectors; ++k) hn::StoreU(v[k], kF, lane + k * kLanes);
    const double a = static_cast<double>(lane[0] + lane[4]) + static_cast<double>(lane[2] + lane[6]);
    const double b = static_cast<double>(lane[1] + lane[5]) + static_cast<double>(lane[3] + lane[7]);
    *total += a + b;
    Clear();
  }
};

HWY_INLINE VF Residual(const PixelSpan& pixels, VF p, std::size_t i, VF gain, VF offset) {
  return hn::Sub(hn::Sub(hn::LoadU(kF, pixels.intensity + i), hn::Mul(gain, p)), offset);
}

// The weight of a pixel that has no trust.
HWY_INLINE VF Missing(const PixelSpan& pixels, VF s, std::size_t i) {
  return hn::IfThenElseZero(hn::Eq(s, hn::Zero(kF)), hn::LoadU(kF, pixels.weight + i));
}

PixelMoments MomentsImpl(const PixelSpan& pixels, const float* value, const float* trust, const float* factor, float gain, float offset,
                         float centre) {
  const VF g = hn::Set(kF, gain);
  const VF o = hn::Set(kF, offset);
  const VF c = hn::Set(kF, centre);
  PixelMoments total;
  Lanes sums[7];
  for (Lanes& sum : sums) sum.Clear();
  for (std::size_t block = 0; block < pixels.count; block += kFlush) {
    const std::size_t end = std::min(block + kFlush, pixels.count);
    for (std::size_t i = block; i < end; i += kPixelBlock) {
      for (std::size_t k = 0; k < kVectors; ++k) {
        const std::size_t at = i + k * kLanes;
        const VF v = hn::LoadU(kF, value + at);
        VF s = hn::LoadU(kF, trust + at);
        sums[6].v[k] = hn::Add(sums[6].v[k], Missing(pixels, s, at));
        if (factor != nullptr) s = hn::Mul(s, hn::LoadU(kF, factor + at));
        const VF r = Residual(pixels, v, at, g, o);
        const VF p = hn::Sub(v, c);
        const VF sp = hn::Mul(s, p);
        const VF sr = hn::Mul(s, r);
        sums[0].v[k] = hn::Add(sums[0].v[k], s);
        sums[1].v[k] = hn::Add(sums[1].v[k], sp);
        sums[2].v[k] = hn::Add(sums[2].v[k], hn::Mul(sp, p));
        sums[3].v[k] = hn::Add(sums[3].v[k], sr);
        sums[4].v[k] = hn::Add(sums[4].v[k], hn::Mul(sr, p));
        sums[5].v[k] = hn::Add(sums[5].v[k], hn::Mul(sr, r));
      }
    }
    double* const targets[7] = {&total.s, &total.p, &total.pp, &total.r, &total.rp, &total.rr, &total.missing};
    for (std::size_t q = 0; q < 7; ++q) sums[q].Flush(targets[q]);
  }
  return total;
}

PixelCost HuberImpl(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k) {
  const VF g = hn::Set(kF, gain);
  const VF o = hn::Set(kF, offset);
  const VF inverse = hn::Set(kF, 1.0F / sigma);
  const VF corner = hn::Set(kF, k);
  const VF half = hn::Set(kF, 0.5F);
  PixelCost total;
  Lanes cost;
  Lanes missing;
  cost.Clear();
  missing.Clear();
  for (std::size_t block = 0; block < pixels.count; block += kFlush) {
    const std::size_t end = std::min(block + kFlush, pixels.count);
    for (std::size_t i = block; i < end; i += kPixelBlock) {
      for (std::size_t q = 0; q < kVectors; ++q) {
        const std::size_t at = i + q * kLanes;
        const VF s = hn::LoadU(kF, trust + at);
        const VF z = hn::Mul(hn::Abs(Residual(pixels, hn::LoadU(kF, value + at), at, g, o)), inverse);
        // rho = c (z - c / 2), c = min(z, k): z^2 / 2 within the corner, k (z - k / 2) beyond.
        const VF c = hn::Min(z, corner);
        const VF rho = hn::Mul(c, hn::Sub(z, hn::Mul(half, c)));
        cost.v[q] = hn::Add(cost.v[q], hn::Mul(s, rho));
        missing.v[q] = hn::Add(missing.v[q], Missing(pixels, s, at));
      }
    }
    cost.Flush(&total.huber);
    missing.Flush(&total.missing);
  }
  return total;
}

void FactorsImpl(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k,
                 float* factor) {
  const VF g = hn::Set(kF, gain);
  const VF o = hn::Set(kF, offset);
  const VF limit = hn::Set(kF, k * sigma);
  for (std::size_t i = 0; i < pixels.count; i += kLanes) {
    const VF r = hn::Abs(Residual(pixels, hn::LoadU(kF, value + i), i, g, o));
    const VF weight = hn::Div(limit, hn::Max(r, limit));
    const auto used = hn::Gt(hn::LoadU(kF, trust + i), hn::Zero(kF));
    hn::StoreU(hn::IfThenElse(used, weight, hn::Set(kF, 1.0F)), kF, factor + i);
  }
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(SampleImpl);
HWY_EXPORT(MomentsImpl);
HWY_EXPORT(HuberImpl);
HWY_EXPORT(FactorsImpl);

void SamplePixels(const PredictionGrid& grid, const PixelMap& map, const PixelSpan& pixels, float* value, float* trust) {
  HWY_DYNAMIC_DISPATCH(SampleImpl)(grid, map, pixels, value, trust);
}

PixelMoments SumMoments(const PixelSpan& pixels, const float* value, const float* trust, const float* factor, float gain, float offset,
                        float centre) {
  return HWY_DYNAMIC_DISPATCH(MomentsImpl)(pixels, value, trust, factor, gain, offset, centre);
}

PixelCost SumHuber(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k) {
  return HWY_DYNAMIC_DISPATCH(HuberImpl)(pixels, value, trust, gain, offset, sigma, k);
}

void HuberFactors(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k,
                  float* factor) {
  HWY_DYNAMIC_DISPATCH(FactorsImpl)(pixels, value, trust, gain, offset, sigma, k, factor);
}

}  // namespace trem
#endif  // HWY_ONCE
