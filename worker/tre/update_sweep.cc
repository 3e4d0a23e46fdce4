#include "worker/tre/update_sweep.h"

#include <algorithm>
#include <memory>

#include "mosaic/base/check.h"
#include "worker/sensor/filter_rows.h"
#include "worker/sensor/reflect.h"

namespace trem {
namespace {

// Lines begin at multiples of this many floats of the image's columns: whole cache lines. Kernels begin there, too, left of what is
// wanted: what they make of the columns before it is not read.
constexpr int kAlign = 16;
// Rows that a filter makes at a time.
constexpr int kBlock = 16;

Roi Grown(const Roi& roi, int by) { return {roi.x0 - by, roi.y0 - by, roi.x1 + by, roi.y1 + by}; }

int AlignedDown(int x) { return x - (((x % kAlign) + kAlign) % kAlign); }

}  // namespace

void UpdateSweep::Ring::Fit(int depth, int stride) {
  depth_ = depth;
  stride_ = stride;
  std::size_t bytes = static_cast<std::size_t>(depth) * static_cast<std::size_t>(stride) * sizeof(float);
  const std::size_t floats = bytes / sizeof(float) + kAlign;
  if (data_.size() < floats) data_.resize(floats);
  void* begin = data_.data();
  std::size_t space = data_.size() * sizeof(float);
  begin_ = static_cast<float*>(std::align(kAlign * sizeof(float), bytes, begin, space));
}

void UpdateSweep::Prepare(const Roi& tile, std::span<const float> momenta) {
  const int radius = psf_.radius();
  const int reach = std::max(2 * radius, 1);  // The prior reads the next cell even where the PSF is a single one.
  const Roi whole{0, 0, width(), height()};
  count_ = momenta.size();
  if (steps_.size() < count_) steps_.resize(count_);
  Roi out = Intersect(region_, planes_.prediction != nullptr ? Grown(tile, radius) : tile);
  for (std::size_t k = count_; k-- > 0;) {
    Step& step = steps_[k];
    step.out = out;
    step.context = Intersect(Grown(out, radius), whole);
    step.support = Intersect(Grown(out, reach), whole);
    step.momentum = momenta[k];
    step.next_extrapolated = step.support.y0;
    step.next_residual = step.context.y0;
    step.next_result = step.out.y0;
    out = Intersect(region_, step.support);
  }
  const Roi& widest = steps_[0].support;
  origin_ = AlignedDown(AlignedDown(widest.x0) - radius - 1);
  stride_ = AlignedDown(widest.x1 + radius + 1 - origin_ + kRowSlack + kAlign);
  // How far each stage may be ahead of the oldest row that is still read, when every stage works in blocks.
  for (std::size_t k = 0; k < count_; ++k) {
    steps_[k].extrapolated.Fit(reach + 3 * kBlock + 2, stride_);
    steps_[k].residual.Fit(2 * radius + 2 * kBlock, stride_);
    steps_[k].result.Fit(reach + 3 * kBlock + 2, stride_);
  }
  lines_.Fit(kFilterLines, stride_);
  rows_.resize(static_cast<std::size_t>(2 * radius + kBlock));
}

FilterBlock UpdateSweep::BlockOf(int row_count, int x0, int x1) {
  FilterBlock block;
  block.rows = rows_.data();
  block.row_count = row_count;
  block.taps = psf_.taps.data();
  block.radius = psf_.radius();
  block.begin = x0;
  block.end = x1;
  block.width = width();
  block.first = AlignedDown(std::max(x0 - block.radius, 0));
  block.lines = Line(lines_.row(0));
  block.stride = stride_;
  return block;
}

void UpdateSweep::Run(const SweepPlanes& planes, const Roi& region, const Roi& tile, std::span<const float> momenta,
                      const StepWeights& weights) {
  TREM_CHECK(!momenta.empty() && !tile.empty() && region.Contains(tile));
  TREM_CHECK(Roi({0, 0, planes.scene->width(), planes.scene->height()}).Contains(region));
  TREM_CHECK(planes.next_scene != planes.scene || tile == region);
  planes_ = planes;
  weights_ = weights;
  region_ = region;
  tile_ = tile;
  Prepare(tile, momenta);
  for (int y = tile.y0; y < tile.y1; y += kBlock) {
    const int end = std::min(y + kBlock, tile.y1);
    if (planes_.prediction != nullptr) {
      MakePrediction(y, end);
    } else {
      MakeResult(count_ - 1, end - 1);
    }
  }
}

// Columns [begin, end) outside the moving part keep the scene's own values.
void UpdateSweep::FillBeside(int y, int begin, int inner_begin, int inner_end, int end, float* line) const {
  const float* scene = planes_.scene->row(y);
  if (begin < inner_begin) std::copy(scene + begin, scene + inner_begin, Line(line, begin));
  if (inner_end < end) std::copy(scene + inner_end, scene + end, Line(line, inner_end));
}

void UpdateSweep::MakeExtrapolated(std::size_t k, int last) {
  Step& step = steps_[k];
  for (; step.next_extrapolated <= last; ++step.next_extrapolated) {
    const int y = step.next_extrapolated;
    float* line = step.extrapolated.row(y);
    const Roi& support = step.support;
    if (y < region_.y0 || y >= region_.y1) {
      FillBeside(y, support.x0, support.x1, support.x1, support.x1, line);
      continue;
    }
    if (k > 0) {
      MakeResult(k - 1, y);  // Which extrapolates what it has made.
      continue;
    }
    const int begin = std::max(region_.x0, support.x0);
    const int end = std::min(region_.x1, support.x1);
    const int first = AlignedDown(begin);
    ExtrapolateRow(planes_.scene->row(y) + first, planes_.previous->row(y) + first, step.momentum, end - first, Line(line, first));
    FillBeside(y, support.x0, begin, end, support.x1, line);
  }
}

void UpdateSweep::MakeResidual(std::size_t k, int last) {
  Step& step = steps_[k];
  const int radius = psf_.radius();
  const Roi& context = step.context;
  while (step.next_residual <= last) {
    const int first = step.next_residual;
    const int count = std::min(kBlock, context.y1 - first);
    step.next_residual += count;
    MakeExtrapolated(k, std::min(first + count - 1 + radius, height() - 1));
    for (int j = 0; j < count + 2 * radius; ++j) {
      rows_[static_cast<std::size_t>(j)] = Line(step.extrapolated.row(ReflectIndex(first + j - radius, height())));
    }
    const float* weight[kBlock];
    const float* weighted[kBlock];
    float* out[kBlock];
    for (int i = 0; i < count; ++i) {
      weight[i] = planes_.weight->row(first + i);
      weighted[i] = planes_.weighted->row(first + i);
      out[i] = Line(step.residual.row(first + i));
    }
    ResidualRows(BlockOf(count, AlignedDown(context.x0), context.x1), weight, weighted, out);
  }
}

void UpdateSweep::MakeResult(std::size_t k, int last) {
  Step& step = steps_[k];
  const int radius = psf_.radius();
  const Roi& out = step.out;
  while (step.next_result <= last) {
    const int first = step.next_result;
    const int count = std::min(kBlock, out.y1 - first);
    step.next_result += count;
    MakeResidual(k, std::min(first + count - 1 + radius, height() - 1));
    if (radius == 0) MakeExtrapolated(k, std::min(first + count, step.support.y1 - 1));
    for (int j = 0; j < count + 2 * radius; ++j) {
      rows_[static_cast<std::size_t>(j)] = Line(step.residual.row(ReflectIndex(first + j - radius, height())));
    }
    StepRow rows[kBlock];
    for (int i = 0; i < count; ++i) rows[i] = RowOf(k, first + i);
    StepBlock block{rows, weights_};
    if (out.x0 == region_.x0) block.left_border = out.x0;
    if (out.x1 == region_.x1) block.right_border = out.x1 - 1;
    if (k + 1 < count_) block.next_momentum = steps_[k + 1].momentum;
    StepRows(BlockOf(count, AlignedDown(out.x0), out.x1), block);
    for (int y = first; y < first + count; ++y) {
      WriteResult(k, y, step.result.row(y));
      if (k + 1 == count_) continue;
      Step& next = steps_[k + 1];
      FillBeside(y, next.support.x0, out.x0, out.x1, next.support.x1, next.extrapolated.row(y));
    }
  }
}

StepRow UpdateSweep::RowOf(std::size_t k, int y) {
  Step& step = steps_[k];
  StepRow row;
  row.start = Line(step.extrapolated.row(y));
  row.above = y > region_.y0 ? Line(step.extrapolated.row(y - 1)) : row.start;
  row.below = y + 1 < region_.y1 ? Line(step.extrapolated.row(y + 1)) : row.start;
  row.majoriser = planes_.majoriser->row(y);
  row.out = Line(step.result.row(y));
  if (k + 1 == count_) return row;
  row.next_start = Line(steps_[k + 1].extrapolated.row(y));
  row.now = k == 0 ? planes_.scene->row(y) : Line(steps_[k - 1].result.row(y));
  return row;
}

void UpdateSweep::WriteResult(std::size_t k, int y, const float* line) {
  if (y < tile_.y0 || y >= tile_.y1) return;
  const float* from = line + (tile_.x0 - origin_);
  if (k + 1 == count_) {
    if (k == 0) {
      const float* scene = planes_.scene->row(y) + tile_.x0;
      std::copy(scene, scene + tile_.width(), planes_.next_previous->row(y) + tile_.x0);
    }
    std::copy(from, from + tile_.width(), planes_.next_scene->row(y) + tile_.x0);
  } else if (k + 2 == count_) {
    std::copy(from, from + tile_.width(), planes_.next_previous->row(y) + tile_.x0);
  }
}

void UpdateSweep::MakePrediction(int first, int last_end) {
  Step& last = steps_[count_ - 1];
  const int radius = psf_.radius();
  const int begin = AlignedDown(std::max(tile_.x0 - radius, 0));
  const int end = std::min(tile_.x1 + radius, width());
  int row = last.next_result;
  MakeResult(count_ - 1, std::min(last_end - 1 + radius, last.out.y1 - 1));
  for (; row < last.next_result; ++row) FillBeside(row, begin, last.out.x0, last.out.x1, end, last.result.row(row));
  const int count = last_end - first;
  for (int j = 0; j < count + 2 * radius; ++j) {
    const int y = ReflectIndex(first + j - radius, height());
    const bool moved = y >= region_.y0 && y < region_.y1;
    rows_[static_cast<std::size_t>(j)] = moved ? Line(last.result.row(y)) : planes_.scene->row(y);
  }
  float* out[kBlock];
  for (int i = 0; i < count; ++i) out[i] = planes_.prediction->row(first + i);
  FilterRows(BlockOf(count, tile_.x0, tile_.x1), out);
}

}  // namespace trem
