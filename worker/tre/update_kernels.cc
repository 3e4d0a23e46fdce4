#include "worker/tre/update_kernels.h"

#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/tre/update_kernels.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

void ResidualRowTarget(const float* predicted, const float* w, const float* z, int count, float* line) {
  const hn::ScalableTag<float> d;
  const std::size_t end = static_cast<std::size_t>(count);
  for (std::size_t x = 0; x < end; x += hn::Lanes(d)) {
    const std::size_t rest = end - x;
    hn::StoreU(hn::MulSub(LoadUpTo(d, w + x, rest), LoadUpTo(d, predicted + x, rest), LoadUpTo(d, z + x, rest)), d, line + x);
  }
}

void ResidualRowsTarget(const FilterBlock& block, const float* const* w, const float* const* z, float* const* out) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  FilterBlockInto(d, block, [&](int i) HWY_ATTR {
    return [d, end = block.end, weight = w[i], weighted = z[i], to = out[i]](int x, V filtered) HWY_ATTR {
      const std::size_t rest = static_cast<std::size_t>(end - x);
      hn::StoreU(hn::MulSub(LoadUpTo(d, weight + x, rest), filtered, LoadUpTo(d, weighted + x, rest)), d, to + x);
    };
  });
}

// 1 / x for positive normal x, never more, short by 2e-5 of it: two of Newton's steps from a guess by the exponent. The same on every
// processor that fuses multiply-adds, and much faster than a division.
template <class D>
HWY_INLINE hn::Vec<D> InverseFromBelow(D d, hn::Vec<D> x) {
  const hn::RebindToSigned<D> di;
  const auto two = hn::Set(d, 2.0F);
  auto y = hn::BitCast(d, hn::Sub(hn::Set(di, 0x7EF311C7), hn::BitCast(di, x)));
  y = hn::Mul(y, hn::NegMulAdd(x, y, two));
  return hn::Mul(y, hn::NegMulAdd(x, y, two));
}

void StepRowsTarget(const FilterBlock& block, const StepBlock& step) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const V high = hn::Set(d, step.weights.limit);
  const V low = hn::Set(d, -step.weights.limit);
  const V lambda = hn::Set(d, step.weights.lambda);
  const V damping = hn::Set(d, step.weights.damping);
  const V momentum = hn::Set(d, step.momentum);
  const auto slope = [=](V a, V b) HWY_ATTR { return hn::Min(hn::Max(hn::Sub(a, b), low), high); };
  const auto at_border = [=](int border, int x, V start, V neighbour) HWY_ATTR {
    if (HWY_LIKELY(border < x || border >= x + lanes)) return neighbour;
    return hn::IfThenElse(hn::Eq(hn::Iota(d, 0.0F), hn::Set(d, static_cast<float>(border - x))), start, neighbour);
  };
  FilterBlockInto(d, block, [&](int i) HWY_ATTR {
    const int left_border = step.left_border;
    const int right_border = step.right_border;
    return [=, row = step.rows[i], end = block.end](int x, V data_gradient) HWY_ATTR {
      const std::size_t rest = static_cast<std::size_t>(end - x);
      const V start = hn::LoadU(d, row.start + x);
      const V left = at_border(left_border, x, start, hn::LoadU(d, row.start + x - 1));
      const V right = at_border(right_border, x, start, hn::LoadU(d, row.start + x + 1));
      const V vertical = hn::Add(slope(start, hn::LoadU(d, row.above + x)), slope(start, hn::LoadU(d, row.below + x)));
      const V slopes = hn::Add(vertical, hn::Add(slope(start, left), slope(start, right)));
      const V gradient = hn::MulAdd(lambda, slopes, data_gradient);
      const V curvature = hn::Add(LoadUpTo(d, row.majoriser + x, rest), damping);
      const V next = hn::NegMulAdd(gradient, InverseFromBelow(d, curvature), start);
      hn::StoreU(next, d, row.out + x);
      hn::StoreU(hn::MulAdd(momentum, hn::Sub(next, LoadUpTo(d, row.previous + x, rest)), next), d, row.next_start + x);
    };
  });
}

void ScaleRowTarget(float factor, int count, float* row) {
  const hn::ScalableTag<float> d;
  const std::size_t end = static_cast<std::size_t>(count);
  for (std::size_t x = 0; x < end; x += hn::Lanes(d)) {
    StoreUpTo(d, hn::Mul(hn::Set(d, factor), LoadUpTo(d, row + x, end - x)), row + x, end - x);
  }
}

void PredictRowTarget(const OverlaidRow& row, int count, float* predicted, float* frames) {
  const hn::ScalableTag<float> d;
  const hn::RebindToSigned<decltype(d)> di;
  using V = hn::Vec<decltype(d)>;
  const std::size_t end = static_cast<std::size_t>(count);
  const auto at = [&](float start, float step, V i) HWY_ATTR { return hn::Add(hn::Set(d, start), hn::Mul(hn::Set(d, step), i)); };
  const V half = hn::Set(d, 0.5F);
  const auto width = hn::Set(di, row.width);
  const auto one = hn::Set(di, 1);
  for (std::size_t u = 0; u < end; u += hn::Lanes(d)) {
    const V i = hn::Iota(d, static_cast<float>(u));
    V x = at(row.x, row.dx, i);
    V y = at(row.y, row.dy, i);
    if (!row.affine) {
      const V scale = hn::Div(hn::Set(d, 1.0F), at(row.depth, row.d_depth, i));
      x = hn::Mul(x, scale);
      y = hn::Mul(y, scale);
    }
    x = hn::Sub(x, hn::Set(d, row.left));
    y = hn::Sub(y, hn::Set(d, row.top));
    const auto within = hn::And(hn::And(hn::Ge(x, hn::Zero(d)), hn::Lt(x, hn::Set(d, static_cast<float>(row.width - 1)))),
                                hn::And(hn::Ge(y, hn::Zero(d)), hn::Lt(y, hn::Set(d, static_cast<float>(row.height - 1)))));
    // Outside, the first cells are read and not used.
    x = hn::IfThenElseZero(within, x);
    y = hn::IfThenElseZero(within, y);
    const auto ix = hn::ConvertTo(di, x);
    const auto iy = hn::ConvertTo(di, y);
    const V tx = hn::Sub(x, hn::ConvertTo(d, ix));
    const V ty = hn::Sub(y, hn::ConvertTo(d, iy));
    const auto first = hn::Add(hn::Mul(iy, width), ix);
    const auto right = hn::IfThenElseZero(hn::RebindMask(di, hn::Ge(tx, half)), one);
    const auto down = hn::IfThenElseZero(hn::RebindMask(di, hn::Ge(ty, half)), width);
    const V seen = hn::GatherIndex(d, row.seen, hn::Add(first, hn::Add(right, down)));
    const auto usable = hn::And(within, hn::Ge(seen, hn::Set(d, row.seen_min)));
    const V above = hn::GatherIndex(d, row.prediction, first);
    const V above_right = hn::GatherIndex(d, row.prediction, hn::Add(first, one));
    const V below = hn::GatherIndex(d, row.prediction, hn::Add(first, width));
    const V below_right = hn::GatherIndex(d, row.prediction, hn::Add(first, hn::Add(width, one)));
    const V upper = hn::Add(above, hn::Mul(tx, hn::Sub(above_right, above)));
    const V lower = hn::Add(below, hn::Mul(tx, hn::Sub(below_right, below)));
    const V value = hn::Add(upper, hn::Mul(ty, hn::Sub(lower, upper)));
    const V scaled = hn::Add(hn::Mul(hn::Set(d, row.gain), value), hn::Set(d, row.offset));
    StoreUpTo(d, hn::IfThenElse(usable, scaled, hn::Set(d, std::numeric_limits<float>::quiet_NaN())), predicted + u, end - u);
    StoreUpTo(d, hn::IfThenElseZero(usable, seen), frames + u, end - u);
  }
}

void RangeOfRowsTarget(const float* const* rows, int count, float* low, float* high) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t end = static_cast<std::size_t>(count);
  for (std::size_t u = 0; u < end; u += hn::Lanes(d)) {
    V least = hn::Set(d, 1e9F);
    V most = hn::Set(d, -1e9F);
    for (int j = 0; j < 3; ++j) {
      const V value = LoadUpTo(d, rows[j] + u, end - u);
      least = hn::IfThenElse(hn::Lt(value, least), value, least);
      most = hn::IfThenElse(hn::Gt(value, most), value, most);
    }
    hn::StoreU(least, d, low + u);
    hn::StoreU(most, d, high + u);
  }
}

void ExplainRowTarget(const ExplainedRow& row, int count, float* variance, float* residual) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t end = static_cast<std::size_t>(count);
  const V one = hn::Set(d, 1.0F);
  const V weight_min = hn::Set(d, 1e-3F);
  for (std::size_t u = 0; u < end; u += hn::Lanes(d)) {
    const std::size_t rest = end - u;
    const V most = hn::Max(hn::LoadU(d, row.high + u), hn::Max(hn::LoadU(d, row.high + u - 1), hn::LoadU(d, row.high + u + 1)));
    const V least = hn::Min(hn::LoadU(d, row.low + u), hn::Min(hn::LoadU(d, row.low + u - 1), hn::LoadU(d, row.low + u + 1)));
    const V contrast = hn::Max(hn::Sub(most, least), hn::Zero(d));
    const V inverse_n = hn::Div(one, hn::Max(LoadUpTo(d, row.frames + u, rest), hn::Set(d, row.seen_min)));
    const V part = hn::Mul(hn::Add(hn::Set(d, row.settled_part), hn::Mul(hn::Set(d, row.fresh_part), inverse_n)), contrast);
    const V weight = row.weights != nullptr ? LoadUpTo(d, row.weights + u, rest) : one;
    const V inverse_weight = hn::Div(one, hn::IfThenElse(hn::Lt(weight, weight_min), weight_min, weight));
    const V noise = hn::Mul(hn::Set(d, row.noise2), hn::Add(inverse_weight, inverse_n));
    StoreUpTo(d, hn::Add(noise, hn::Mul(part, part)), variance + u, rest);
    const V left = hn::Sub(LoadUpTo(d, row.pixels + u, rest), LoadUpTo(d, row.predicted + u, rest));
    const V nothing = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
    StoreUpTo(d, hn::IfThenElse(hn::Gt(weight, hn::Zero(d)), left, nothing), residual + u, rest);
  }
}

int FindUnlikeTarget(const float* row, float value, int count) {
  const hn::ScalableTag<float> d;
  const std::size_t end = static_cast<std::size_t>(count);
  const auto wanted = hn::Set(d, value);
  std::size_t x = 0;
  for (; x + hn::Lanes(d) <= end; x += hn::Lanes(d)) {
    const std::ptrdiff_t lane = hn::FindFirstTrue(d, hn::Ne(hn::LoadU(d, row + x), wanted));
    if (lane >= 0) return static_cast<int>(x) + static_cast<int>(lane);
  }
  for (; x < end; ++x) {
    if (row[x] != value) return static_cast<int>(x);
  }
  return count;
}

TextureSums SumTextureTarget(const float* row, const float* below, const float* seen, float seen_min, int count) {
  constexpr std::size_t kLanes = 8;
  const hn::CappedTag<float, kLanes> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t end = static_cast<std::size_t>(count);
  const V least = hn::Set(d, seen_min);
  HWY_ALIGN float lanes[4][kLanes];
  for (std::size_t group = 0; group < kLanes; group += hn::Lanes(d)) {
    V size = hn::Zero(d);
    V squares = size;
    V frames = size;
    V cells = size;
    for (std::size_t x = group; x < end; x += kLanes) {
      const V n = LoadUpTo(d, seen + x, end - x);
      const auto used = hn::Ge(n, least);
      const V centre = LoadUpTo(d, row + x, end - x);
      const V across = hn::IfThenElseZero(used, hn::Sub(LoadUpTo(d, row + x + 1, end - x), centre));
      const V down = hn::IfThenElseZero(used, hn::Sub(LoadUpTo(d, below + x, end - x), centre));
      size = hn::Add(size, hn::Add(hn::Abs(across), hn::Abs(down)));
      squares = hn::Add(squares, hn::Add(hn::Mul(across, across), hn::Mul(down, down)));
      frames = hn::Add(frames, hn::IfThenElseZero(used, n));
      cells = hn::Add(cells, hn::IfThenElseZero(used, hn::Set(d, 1.0F)));
    }
    hn::StoreU(size, d, lanes[0] + group);
    hn::StoreU(squares, d, lanes[1] + group);
    hn::StoreU(frames, d, lanes[2] + group);
    hn::StoreU(cells, d, lanes[3] + group);
  }
  double total[4] = {};
  for (int k = 0; k < 4; ++k) {
    for (const float lane : lanes[k]) total[k] += static_cast<double>(lane);
  }
  return {total[0], total[1], total[2], total[3]};
}

void SeenRowTarget(const float* tents, const float* near, int ratio, const SeenLimits& limits, int count, float* seen) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t end = static_cast<std::size_t>(count);
  const V scale = hn::Set(d, 1.0F / static_cast<float>(ratio * ratio));
  for (std::size_t x = 0; x < end; x += hn::Lanes(d)) {
    V sum = hn::Mul(hn::Set(d, static_cast<float>(ratio)), hn::LoadU(d, tents + x));
    for (int i = 1; i < ratio; ++i) {
      const V pair = hn::Add(hn::LoadU(d, tents + x - i), hn::LoadU(d, tents + x + i));
      sum = hn::MulAdd(hn::Set(d, static_cast<float>(ratio - i)), pair, sum);
    }
    V about = hn::LoadU(d, near + x);
    for (int i = 1; i <= ratio / 2; ++i) about = hn::Add(about, hn::Add(hn::LoadU(d, near + x - i), hn::LoadU(d, near + x + i)));
    const V frames = hn::Mul(scale, sum);
    const auto many = hn::Ge(frames, hn::Set(d, limits.many_frames));
    const auto bare = hn::Lt(about, hn::Mul(hn::Set(d, limits.near_part_min), frames));
    StoreUpTo(d, hn::IfThenZeroElse(hn::And(many, bare), frames), seen + x, end - x);
  }
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(ResidualRowTarget);
HWY_EXPORT(ResidualRowsTarget);
HWY_EXPORT(StepRowsTarget);
HWY_EXPORT(ScaleRowTarget);
HWY_EXPORT(PredictRowTarget);
HWY_EXPORT(RangeOfRowsTarget);
HWY_EXPORT(ExplainRowTarget);
HWY_EXPORT(FindUnlikeTarget);
HWY_EXPORT(SumTextureTarget);
HWY_EXPORT(SeenRowTarget);

void ResidualRow(const float* predicted, const float* w, const float* z, int count, float* line) {
  HWY_DYNAMIC_DISPATCH(ResidualRowTarget)(predicted, w, z, count, line);
}

void ResidualRows(const FilterBlock& block, const float* const* w, const float* const* z, float* const* out) {
  HWY_DYNAMIC_DISPATCH(ResidualRowsTarget)(block, w, z, out);
}

void StepRows(const FilterBlock& block, const StepBlock& step) { HWY_DYNAMIC_DISPATCH(StepRowsTarget)(block, step); }

void ScaleRow(float factor, int count, float* row) { HWY_DYNAMIC_DISPATCH(ScaleRowTarget)(factor, count, row); }

void PredictRow(const OverlaidRow& row, int count, float* predicted, float* frames) {
  HWY_DYNAMIC_DISPATCH(PredictRowTarget)(row, count, predicted, frames);
}

void RangeOfRows(const float* const* rows, int count, float* low, float* high) {
  HWY_DYNAMIC_DISPATCH(RangeOfRowsTarget)(rows, count, low, high);
}

void ExplainRow(const ExplainedRow& row, int count, float* variance, float* residual) {
  HWY_DYNAMIC_DISPATCH(ExplainRowTarget)(row, count, variance, residual);
}

int FindUnlike(const float* row, float value, int count) { return HWY_DYNAMIC_DISPATCH(FindUnlikeTarget)(row, value, count); }

TextureSums SumTexture(const float* row, const float* below, const float* seen, float seen_min, int count) {
  return HWY_DYNAMIC_DISPATCH(SumTextureTarget)(row, below, seen, seen_min, count);
}

void SeenRow(const float* tents, const float* near, int ratio, const SeenLimits& limits, int count, float* seen) {
  HWY_DYNAMIC_DISPATCH(SeenRowTarget)(tents, near, ratio, limits, count, seen);
}

}  // namespace trem
#endif  // HWY_ONCE
