#include "worker/tre/update_sweep.h"

#include <algorithm>
#include <memory>

#include "mosaic/base/check.h"
#include "worker/sensor/filter_rows.h"
#include "worker/sensor/reflect.h"
#include "worker/tre/scene_buffer.h"

namespace trem {
namespace {

// Lines begin at multiples of this many floats of the image's columns: whole cache lines. Kernels begin there, too, left of what is
// wanted: what they make of the columns before it is not read.
constexpr int kAlign = 16;
// Rows that a filter makes at a time.
constexpr int kBlock = 16;

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
  if (steps_.size() < count_ + 1) steps_.resize(count_ + 1);
  const Roi around = Intersect(Grown(region_, radius), whole);
  predicted_ = {tile.x0 == region_.x0 ? around.x0 : tile.x0, tile.y0 == region_.y0 ? around.y0 : tile.y0,
                tile.x1 == region_.x1 ? around.x1 : tile.x1, tile.y1 == region_.y1 ? around.y1 : tile.y1};
  steps_[count_].support = Intersect(Grown(predicted_, radius), whole);
  for (std::size_t k = count_; k-- > 0;) {
    Step& step = steps_[k];
    step.out = Intersect(region_, steps_[k + 1].support);
    step.context = Intersect(Grown(step.out, radius), whole);
    // What the first step starts from has been blurred already.
    step.support = Intersect(Grown(step.out, k == 0 ? 1 : reach), whole);
    step.momentum = momenta[k];
    step.next_residual = step.context.y0;
    step.next_result = step.out.y0;
  }
  int left = steps_[0].context.x0;
  int right = steps_[0].context.x1;
  for (std::size_t k = 0; k <= count_; ++k) {
    steps_[k].next_start = steps_[k].support.y0;
    left = std::min(left, steps_[k].support.x0);
    right = std::max(right, steps_[k].support.x1);
  }
  origin_ = AlignedDown(AlignedDown(left) - radius - 1);
  stride_ = AlignedDown(right + radius + 1 - origin_ + kRowSlack + kAlign);
  // How far each stage may be ahead of the oldest row that is still read, when every stage works in blocks.
  for (std::size_t k = 0; k <= count_; ++k) {
    steps_[k].start.Fit(reach + 3 * kBlock + 2, stride_);
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
  const bool in_place =
      planes.next_scene == planes.scene || planes.next_previous == planes.previous || planes.next_prediction == planes.prediction;
  TREM_CHECK(!in_place || tile == region);
  planes_ = planes;
  weights_ = weights;
  region_ = region;
  tile_ = tile;
  Prepare(tile, momenta);
  for (int y = predicted_.y0; y < predicted_.y1; y += kBlock) MakePrediction(y, std::min(y + kBlock, predicted_.y1));
}

// Columns [begin, end) outside the moving part keep the scene's own values.
void UpdateSweep::FillBeside(int y, int begin, int inner_begin, int inner_end, int end, float* line) const {
  const float* scene = planes_.scene->row(y);
  if (begin < inner_begin) std::copy(scene + begin, scene + inner_begin, Line(line, begin));
  if (inner_end < end) std::copy(scene + inner_end, scene + end, Line(line, inner_end));
}

void UpdateSweep::MakeStart(std::size_t k, int last) {
  Step& step = steps_[k];
  for (; step.next_start <= last; ++step.next_start) {
    const int y = step.next_start;
    if (k > 0 && y >= region_.y0 && y < region_.y1) {
      MakeResult(k - 1, y);  // Which extrapolates what it has made.
    } else {
      FillBeside(y, step.support.x0, step.support.x1, step.support.x1, step.support.x1, step.start.row(y));
    }
  }
}

void UpdateSweep::MakeResidual(std::size_t k, int last) {
  Step& step = steps_[k];
  const int radius = psf_.radius();
  const Roi& context = step.context;
  const int begin = AlignedDown(context.x0);
  for (; k == 0 && step.next_residual <= last; ++step.next_residual) {
    const int y = step.next_residual;
    ResidualRow(planes_.prediction->row(y) + begin, planes_.weight->row(y) + begin, planes_.weighted->row(y) + begin, context.x1 - begin,
                Line(step.residual.row(y), begin));
  }
  while (step.next_residual <= last) {
    const int first = step.next_residual;
    const int count = std::min(kBlock, context.y1 - first);
    step.next_residual += count;
    MakeStart(k, std::min(first + count - 1 + radius, height() - 1));
    for (int j = 0; j < count + 2 * radius; ++j) {
      rows_[static_cast<std::size_t>(j)] = Line(step.start.row(ReflectIndex(first + j - radius, height())));
    }
    const float* weight[kBlock];
    const float* weighted[kBlock];
    float* out[kBlock];
    for (int i = 0; i < count; ++i) {
      weight[i] = planes_.weight->row(first + i);
      weighted[i] = planes_.weighted->row(first + i);
      out[i] = Line(step.residual.row(first + i));
    }
    ResidualRows(BlockOf(count, begin, context.x1), weight, weighted, out);
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
    MakeStart(k, std::min(first + count, step.support.y1 - 1));
    for (int j = 0; j < count + 2 * radius; ++j) {
      rows_[static_cast<std::size_t>(j)] = Line(step.residual.row(ReflectIndex(first + j - radius, height())));
    }
    StepRow rows[kBlock];
    for (int i = 0; i < count; ++i) rows[i] = RowOf(k, first + i);
    StepBlock block{rows, weights_};
    if (out.x0 == region_.x0) block.left_border = out.x0;
    if (out.x1 == region_.x1) block.right_border = out.x1 - 1;
    block.momentum = step.momentum;
    StepRows(BlockOf(count, AlignedDown(out.x0), out.x1), block);
    Step& next = steps_[k + 1];
    for (int y = first; y < first + count; ++y) {
      FillBeside(y, next.support.x0, out.x0, out.x1, next.support.x1, next.start.row(y));
      if (k + 1 == count_) WriteResult(y);
    }
  }
}

StepRow UpdateSweep::RowOf(std::size_t k, int y) {
  Step& step = steps_[k];
  StepRow row;
  row.start = Line(step.start.row(y));
  row.above = y > region_.y0 ? Line(step.start.row(y - 1)) : row.start;
  row.below = y + 1 < region_.y1 ? Line(step.start.row(y + 1)) : row.start;
  row.majoriser = planes_.majoriser->row(y);
  row.out = Line(step.result.row(y));
  row.previous = k == 0 ? planes_.previous->row(y) : Line(steps_[k - 1].result.row(y));
  row.next_start = Line(steps_[k + 1].start.row(y));
  return row;
}

void UpdateSweep::WriteResult(int y) {
  if (y < tile_.y0 || y >= tile_.y1) return;
  std::copy_n(Line(steps_[count_ - 1].result.row(y), tile_.x0), tile_.width(), planes_.next_previous->row(y) + tile_.x0);
  std::copy_n(Line(steps_[count_].start.row(y), tile_.x0), tile_.width(), planes_.next_scene->row(y) + tile_.x0);
}

void UpdateSweep::MakePrediction(int first, int end) {
  Step& last = steps_[count_];
  const int radius = psf_.radius();
  MakeStart(count_, std::min(end - 1 + radius, last.support.y1 - 1));
  const int count = end - first;
  for (int j = 0; j < count + 2 * radius; ++j) {
    rows_[static_cast<std::size_t>(j)] = Line(last.start.row(ReflectIndex(first + j - radius, height())));
  }
  float* out[kBlock];
  for (int i = 0; i < count; ++i) out[i] = planes_.next_prediction->row(first + i);
  FilterRows(BlockOf(count, predicted_.x0, predicted_.x1), out);
}

}  // namespace trem
