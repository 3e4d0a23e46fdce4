#include "worker/tre/information_update.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "mosaic/base/parallel.h"
#include "worker/sensor/filter_rows.h"
#include "worker/tre/splat_kernel.h"

namespace trem {
namespace {

void FitSize(const Image<float>& like, Image<float>* image) {
  if (image->width() != like.width() || image->height() != like.height()) *image = Image<float>(like.width(), like.height());
}

// Cells beyond the last samples of many frames of a fixed camera are fitted through the PSF's tails, but not determined by the data: what
// they hold is amplified noise. They count as not seen when less than this part of the samples about them lies within half a sensor
// pixel. Where few frames were seen, samples are sparse and the test would punch holes.
constexpr SeenLimits kSeenLimits{3.0F, 0.25F};

// Keeps the step finite where nothing is known: no samples and no prior.
constexpr float kCurvatureMin = 1e-6F;

// Rows that are judged or predicted at a time, and that are splatted.
constexpr int kBandRows = 32;
constexpr int kSplatRows = 32;

// Rows of which the columns are filtered at a time.
constexpr int kSeenBlock = 16;

// Cells that are counted beyond a region, for what it will have moved before it is counted again.
constexpr int kCountBeyond = 2;

// Iterations that one sweep over a tile carries out.
constexpr std::size_t kStepsPerSweep = 4;
// Tiles keep a sweep's window of rows within the last-level cache. Up to this many columns a region is one tile, which is faster than
// narrow tiles that stay in the second-level cache: those recompute their neighbours' margins.
constexpr int kTileWidth = 4096;

// With several threads, tiles of a large region have up to this many rows; a region is cut when it is this part of the image.
constexpr int kTileHeight = 1024;
constexpr double kPartForTiles = 0.25;
// Cells from which several threads are worth their start.
constexpr long long kCellsForThreads = 1 << 15;

// `region` of an image of `image_cells` cells cut into equal tiles, as many for each of the threads.
std::vector<Roi> Tiles(const Roi& region, int threads, double image_cells) {
  const int columns = (region.width() + kTileWidth - 1) / kTileWidth;
  // Several tiles are written beside the image, and what is not theirs is copied: not worth it for a strip of it.
  const bool parts = threads > 1 && static_cast<double>(region.area()) > kPartForTiles * image_cells;
  const int per_thread = (region.height() + kTileHeight * threads - 1) / (kTileHeight * std::max(threads, 1));
  const int rows = parts ? std::clamp(region.height() / kBandRows, 1, per_thread * threads) : 1;
  std::vector<Roi> tiles;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      tiles.push_back({region.x0 + region.width() * i / columns, region.y0 + region.height() * j / rows,
                       region.x0 + region.width() * (i + 1) / columns, region.y0 + region.height() * (j + 1) / rows});
    }
  }
  return tiles;
}

// to = from outside `region`.
void CopyOutside(const Image<float>& from, const Roi& region, Image<float>* to) {
  for (int y = 0; y < from.height(); ++y) {
    const float* source = from.row(y);
    float* target = to->row(y);
    if (y < region.y0 || y >= region.y1) {
      std::copy(source, source + from.width(), target);
      continue;
    }
    std::copy(source, source + region.x0, target);
    std::copy(source + region.x1, source + from.width(), target + region.x1);
  }
}

// [begin, end) cut into bands of `rows`.
int BandCount(int begin, int end, int rows = kBandRows) { return std::max(end - begin + rows - 1, 0) / rows; }

Roi Band(const Roi& roi, int index, int rows = kBandRows) {
  return {roi.x0, roi.y0 + index * rows, roi.x1, std::min(roi.y0 + (index + 1) * rows, roi.y1)};
}

// Whether no pixel of `row` (all `count` of them) can fall nearest to rows [begin, end): both ends lie on the same side.
bool Misses(const SplatRow& row, int begin, int end, int count) {
  const double far_depth = row.depth + count * row.d_depth;
  if (!(row.depth > 0.0 && far_depth > 0.0)) return false;
  const double near_y = row.y / row.depth;
  const double far_y = (row.y + count * row.dy) / far_depth;
  return std::max(near_y, far_y) < begin - 1.0 || std::min(near_y, far_y) > end + 1.0;
}

// The pixels of `row` (all `count` of them) that may fall nearest to rows [begin, end) of the buffer; begin is a multiple of 4.
void LimitTo(int begin, int end, int count, SplatRow* row) {
  double first = 0.0;
  double last = count;
  // Leaves out where value + u * slope is negative.
  const auto limit = [&](double value, double slope) {
    if (std::abs(slope) * count < 0.25) {
      if (value < -0.5) last = 0.0;
    } else if (slope > 0.0) {
      first = std::max(first, std::floor(-value / slope));
    } else {
      last = std::min(last, std::ceil(-value / slope) + 1.0);
    }
  };
  const double low = begin - 1.0;
  const double high = end + 1.0;
  limit(row->y - low * row->depth, row->dy - low * row->d_depth);
  limit(high * row->depth - row->y, high * row->d_depth - row->dy);
  row->begin = static_cast<int>(std::min(first, static_cast<double>(count))) / 4 * 4;
  row->end = static_cast<int>(std::max(last, 0.0));
}

}  // namespace

void InformationUpdate::AddFrame(const Observation& observation, const View& view, const Roi& region, SceneBuffer* buffer) const {
  const Roi inner = buffer->InBuffer(region);
  const Roi whole{0, 0, buffer->scene.width(), buffer->scene.height()};
  const Roi& roi = observation.roi;
  const PlanarMap& map = view.scene_from_sensor;
  const Eigen::Vector2d origin(buffer->extent.x0, buffer->extent.y0);
  // Of a step along a row: in the scene times the depth, and relative to the buffer.
  const Eigen::Vector2d along = map.linear.col(0) - map.perspective.x() * origin;
  const SplatModel model{static_cast<float>(view.gain), static_cast<float>(view.offset),
                         static_cast<float>(options_.huber_sigmas * observation.noise_sigma)};
  const SplatPlanes planes{&buffer->prediction, &buffer->seen, &buffer->weight, &buffer->weighted};
  ++buffer->counted.frames;
  buffer->counted.slack += bound_.Of(observation, view, buffer->extent);
  // Each band of the scene's rows takes its samples from all of the frame, in the frame's order: no two bands write the same cell.
  ForEachIndex(options_.threads, BandCount(whole.y0, whole.y1, kSplatRows), [&](int index, int) {
    const Roi band = Band(whole, index, kSplatRows);
    if (options_.forgetting < 1.0) {
      const Roi faded = Intersect(band, inner);
      for (int y = faded.y0; y < faded.y1; ++y) {
        ScaleRow(static_cast<float>(options_.forgetting), faded.width(), buffer->weight.row(y) + faded.x0);
        ScaleRow(static_cast<float>(options_.forgetting), faded.width(), buffer->weighted.row(y) + faded.x0);
      }
    }
    for (int v = 0; v < roi.height(); ++v) {
      const Eigen::Vector2d pixel(roi.x0, roi.y0 + v);
      SplatRow row;
      row.depth = map.Depth(pixel);
      row.d_depth = map.perspective.x();
      const Eigen::Vector2d first = map.linear * pixel + map.offset - row.depth * origin;
      row.x = first.x();
      row.y = first.y();
      row.dx = along.x();
      row.dy = along.y();
      if (Misses(row, band.y0, band.y1, roi.width())) continue;
      LimitTo(band.y0, band.y1, roi.width(), &row);
      if (row.begin >= row.end) continue;
      row.pixels = observation.roi_pixels->row(v);
      row.weights = observation.weights != nullptr ? observation.weights->row(v) : nullptr;
      Splat(row, model, band.y0, band.y1, planes);
    }
  });
}

InformationUpdate::Scratch& InformationUpdate::ScratchOf(int slot) { return scratch_[static_cast<std::size_t>(slot)]; }

void InformationUpdate::FitScratch() {
  const std::size_t threads = static_cast<std::size_t>(std::max(options_.threads, 1));
  while (scratch_.size() < threads) scratch_.push_back({Blur(blur_.psf()), {}, {}});
}

bool InformationUpdate::RefreshSeen(const Roi& region, int ratio, int every, SceneBuffer* buffer) {
  const SceneBuffer::Count& counted = buffer->counted;
  const bool known = blur_.psf().negative_mass == 0.0 && std::isfinite(counted.slack);
  if (known && counted.frames < every && counted.region.Contains(Intersect(region, buffer->extent))) return false;
  UpdateSeen(every > 1 ? Grown(region, kCountBeyond) : region, ratio, buffer);
  return true;
}

void InformationUpdate::UpdateSeen(const Roi& region, int ratio, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  buffer->counted = {Intersect(region, buffer->extent)};
  if (inner.empty()) return;
  // Tents one sensor pixel wide to either side: the samples of one frame add up to 1 everywhere inside its ROI.
  std::vector<float> tent_taps;
  for (int i = 0; i < ratio; ++i) tent_taps.push_back(static_cast<float>(ratio - i));
  const std::vector<float> near_taps(static_cast<std::size_t>(ratio / 2 + 1), 1.0F);
  const Image<float>& weight = buffer->weight;
  // Beyond the buffer there are no samples.
  const std::vector<float> nothing(static_cast<std::size_t>(weight.width()), 0.0F);
  FitScratch();
  ForEachIndex(options_.threads, BandCount(inner.y0, inner.y1), [&](int index, int slot) {
    const Roi band = Band(inner, index);
    Scratch& scratch = ScratchOf(slot);
    scratch.blur.ApplyAdjoint(weight, band, &buffer->majoriser);
    const int begin = std::max(band.x0 - ratio, 0);
    const int end = std::min(band.x1 + ratio, weight.width());
    const int stride = band.width() + 2 * ratio + kRowSlack;
    const int shift = ratio - band.x0;  // Column x of the buffer is at x + shift of a line.
    std::vector<float>& tents = scratch.tents;
    std::vector<float>& near = scratch.near;
    for (std::vector<float>* lines : {&tents, &near}) {
      lines->resize(static_cast<std::size_t>(stride) * kSeenBlock);
      // What lies beyond the buffer is not written below.
      if (begin + shift > 0 || end + shift < band.width() + 2 * ratio) std::fill(lines->begin(), lines->end(), 0.0F);
    }
    std::vector<const float*> rows(static_cast<std::size_t>(2 * ratio - 2 + kSeenBlock));
    for (int first = band.y0; first < band.y1; first += kSeenBlock) {
      const int count = std::min(kSeenBlock, band.y1 - first);
      for (int j = 0; j < count + 2 * ratio - 2; ++j) {
        const int y = first + j - ratio + 1;
        rows[static_cast<std::size_t>(j)] = (y >= 0 && y < weight.height() ? weight.row(y) : nothing.data()) + begin;
      }
      FilterColumnBlock(rows.data(), tent_taps.data(), ratio - 1, count, end - begin, tents.data() + begin + shift, stride);
      FilterColumnBlock(rows.data() + (ratio - 1 - ratio / 2), near_taps.data(), ratio / 2, count, end - begin, near.data() + begin + shift,
                        stride);
      for (int i = 0; i < count; ++i) {
        const std::ptrdiff_t line = static_cast<std::ptrdiff_t>(i) * stride + ratio;
        SeenRow(tents.data() + line, near.data() + line, ratio, kSeenLimits, band.width(), buffer->seen.row(first + i) + band.x0);
      }
    }
  });
  AddNegativePart(inner, buffer);
}

void InformationUpdate::AddNegativePart(const Roi& inner, SceneBuffer* buffer) const {
  const float negative = static_cast<float>(blur_.psf().negative_mass);
  if (negative == 0.0F) return;
  const Roi whole{0, 0, buffer->weight.width(), buffer->weight.height()};
  const Roi read = Intersect(Grown(inner, blur_.psf().radius()), whole);
  float weight_max = 0.0F;
  for (int y = read.y0; y < read.y1; ++y) {
    for (int x = read.x0; x < read.x1; ++x) weight_max = std::max(weight_max, buffer->weight.at(x, y));
  }
  const float factor = 1.0F + 2.0F * negative;
  const float floor = 8.0F * negative * weight_max;
  for (int y = inner.y0; y < inner.y1; ++y) {
    for (int x = inner.x0; x < inner.x1; ++x) buffer->majoriser.at(x, y) = factor * (std::max(buffer->majoriser.at(x, y), 0.0F) + floor);
  }
}

void InformationUpdate::Predict(const Roi& region, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  FitScratch();
  // A strip of new ground is done before another thread has woken up.
  const int threads = inner.area() < kCellsForThreads ? 1 : options_.threads;
  ForEachIndex(threads, BandCount(inner.y0, inner.y1),
               [&](int index, int slot) { ScratchOf(slot).blur.Apply(buffer->scene, Band(inner, index), &buffer->prediction); });
}

float InformationUpdate::NextMomentum() {
  ++steps_;
  return static_cast<float>(std::min(options_.momentum_max, steps_ / (steps_ + 3.0)));
}

void InformationUpdate::Iterate(const Roi& region, int iterations, float lambda, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  if (inner.empty() || iterations < 1) return;
  const bool known_prior = options_.prior.kind == StructurePriorKind::kHuberTv || options_.prior.kind == StructurePriorKind::kMembrane;
  if (options_.fused && known_prior && blur_.psf().is_rank_one_symmetric()) {
    IterateFused(inner, iterations, lambda, buffer);
  } else {
    IterateInPasses(inner, iterations, lambda, buffer);
    Predict(Grown(region, blur_.psf().radius()), buffer);
  }
}

void InformationUpdate::Converge(const Roi& region, int iterations, float lambda, SceneBuffer* buffer) {
  const int steps = std::exchange(steps_, 0);
  const double momentum_max = std::exchange(options_.momentum_max, 1.0);
  const Roi around = Grown(region, blur_.psf().radius());
  buffer->previous = buffer->scene;
  Predict(around, buffer);
  Iterate(region, iterations, lambda, buffer);
  // The next frame brings other samples: what the scene was moving towards is no longer where it goes.
  buffer->scene = buffer->previous;
  Predict(around, buffer);
  options_.momentum_max = momentum_max;
  steps_ = steps;
}

void InformationUpdate::IterateFused(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer) {
  StepWeights weights;
  weights.lambda = lambda;
  weights.limit = options_.prior.kind == StructurePriorKind::kHuberTv ? options_.prior.delta : std::numeric_limits<float>::max();
  weights.damping = lambda * StructurePrior::kCurvatureMax + buffer->counted.slack + kCurvatureMin;
  const std::vector<Roi> tiles = Tiles(inner, options_.threads, static_cast<double>(buffer->extent.area()));
  const bool in_place = tiles.size() == 1;
  if (!in_place) {
    FitSize(buffer->scene, &next_scene_);
    FitSize(buffer->scene, &next_previous_);
    FitSize(buffer->scene, &next_prediction_);
  }
  const Roi whole{0, 0, buffer->scene.width(), buffer->scene.height()};
  const Roi around = Intersect(Grown(inner, blur_.psf().radius()), whole);
  const std::size_t threads = static_cast<std::size_t>(std::max(options_.threads, 1));
  while (sweeps_.size() < threads) sweeps_.emplace_back(blur_.psf());
  std::vector<float> momenta;
  while (iterations > 0) {
    momenta.clear();
    for (; iterations > 0 && momenta.size() < kStepsPerSweep; --iterations) momenta.push_back(NextMomentum());
    SweepPlanes planes{&buffer->scene,     &buffer->previous, &buffer->prediction, &buffer->weight,    &buffer->weighted,
                       &buffer->majoriser, &buffer->scene,    &buffer->previous,   &buffer->prediction};
    if (!in_place) {
      planes.next_scene = &next_scene_;
      planes.next_previous = &next_previous_;
      planes.next_prediction = &next_prediction_;
    }
    ForEachIndex(options_.threads, static_cast<int>(tiles.size()), [&](int tile, int slot) {
      sweeps_[static_cast<std::size_t>(slot)].Run(planes, inner, tiles[static_cast<std::size_t>(tile)], momenta, weights);
    });
    if (in_place) continue;
    CopyOutside(buffer->scene, inner, &next_scene_);
    CopyOutside(buffer->previous, inner, &next_previous_);
    CopyOutside(buffer->prediction, around, &next_prediction_);
    std::swap(buffer->scene, next_scene_);
    std::swap(buffer->previous, next_previous_);
    std::swap(buffer->prediction, next_prediction_);
  }
}

void InformationUpdate::IterateInPasses(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer) {
  FitSize(buffer->scene, &residual_);
  FitSize(buffer->scene, &gradient_);
  // The gradient in the region reads residuals a radius beyond it; there the scene stays unmoved.
  const Roi context = Intersect(Grown(inner, blur_.psf().radius()), {0, 0, buffer->scene.width(), buffer->scene.height()});
  const float curvature = lambda * options_.prior.curvature_max() + buffer->counted.slack;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const float momentum = NextMomentum();
    blur_.Apply(buffer->scene, context, &residual_);
    for (int y = context.y0; y < context.y1; ++y) {
      const float* w = buffer->weight.row(y);
      const float* z = buffer->weighted.row(y);
      float* r = residual_.row(y);
      for (int x = context.x0; x < context.x1; ++x) r[x] = w[x] * r[x] - z[x];
    }
    blur_.ApplyAdjoint(residual_, inner, &gradient_);
    options_.prior.AddGradient(buffer->scene, inner, lambda, &gradient_);
    for (int y = inner.y0; y < inner.y1; ++y) {
      const float* g = gradient_.row(y);
      const float* majoriser = buffer->majoriser.row(y);
      float* scene = buffer->scene.row(y);
      float* previous = buffer->previous.row(y);
      for (int x = inner.x0; x < inner.x1; ++x) {
        const float next = scene[x] - g[x] / (majoriser[x] + curvature + kCurvatureMin);
        scene[x] = next + momentum * (next - previous[x]);
        previous[x] = next;
      }
    }
  }
}

}  // namespace trem
