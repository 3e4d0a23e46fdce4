#include "worker/tre/pointwise_update.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

constexpr std::uint64_t kOrderStream = 0x706f696e74ULL;

Image<float> DenseKernel(const Psf& psf) {
  const int radius = psf.radius();
  const int side = 2 * radius + 1;
  Image<float> kernel(side, side);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const auto tap = [&](int i) { return psf.taps[static_cast<std::size_t>(std::abs(i - radius))]; };
      if (psf.is_rank_one_symmetric()) kernel.at(x, y) = tap(x) * tap(y);
      for (const PsfTerm& term : psf.terms) {
        kernel.at(x, y) += term.row[static_cast<std::size_t>(x)] * term.column[static_cast<std::size_t>(y)];
      }
    }
  }
  return kernel;
}

// `i` and where reflection at the ends of [0, size) puts it within `radius` beyond them; returns how many.
int Images(int i, int size, int radius, int (&images)[3]) {
  int count = 0;
  images[count++] = i;
  if (-1 - i >= -radius) images[count++] = -1 - i;
  if (2 * size - 1 - i < size + radius) images[count++] = 2 * size - 1 - i;
  return count;
}

}  // namespace

PointwiseUpdate::PointwiseUpdate(const Psf& psf, std::uint64_t seed, std::uint64_t segment_id)
    : blur_(psf), kernel_(DenseKernel(psf)), seed_(seed), segment_id_(segment_id) {}

template <typename Visit>
void PointwiseUpdate::ForEachRow(int x, int y, int width, int height, const Visit& visit) const {
  const int radius = blur_.psf().radius();
  int xs[3];
  int ys[3];
  const int x_count = Images(x, width, radius, xs);
  const int y_count = Images(y, height, radius, ys);
  for (int b = 0; b < y_count; ++b) {
    for (int a = 0; a < x_count; ++a) {
      const int first = std::max(xs[a] - radius, 0);
      const int last = std::min(xs[a] + radius, width - 1);
      for (int row = std::max(ys[b] - radius, 0); row <= std::min(ys[b] + radius, height - 1); ++row) {
        visit(kernel_.row(row - ys[b] + radius) + (first - xs[a] + radius), first, row, last - first + 1);
      }
    }
  }
}

void PointwiseUpdate::VisitCell(int x, int y, const Roi& inner, const StructurePrior& prior, float lambda, SceneBuffer* buffer) {
  const int width = buffer->scene.width();
  const int height = buffer->scene.height();
  float slope = 0.0F;
  float curvature = 0.0F;
  ForEachRow(x, y, width, height, [&](const float* h, int first, int row, int count) {
    const float* misfit = misfit_.row(row) + first;
    const float* weight = buffer->weight.row(row) + first;
    for (int i = 0; i < count; ++i) {
      slope += h[i] * misfit[i];
      curvature += h[i] * h[i] * weight[i];
    }
  });
  // Reflected images of a cell overlap: (sum of k numbers)^2 <= k * sum of their squares.
  int images[3];
  const int radius = blur_.psf().radius();
  curvature *= static_cast<float>(Images(x, width, radius, images) * Images(y, height, radius, images));
  const CellSlope structure = prior.SlopeAt(buffer->scene, inner, x, y);
  const float step = -(slope + lambda * structure.slope) / (curvature + lambda * structure.curvature + 1e-6F);
  buffer->scene.at(x, y) += step;
  ForEachRow(x, y, width, height, [&](const float* h, int first, int row, int count) {
    float* misfit = misfit_.row(row) + first;
    const float* weight = buffer->weight.row(row) + first;
    for (int i = 0; i < count; ++i) misfit[i] += step * h[i] * weight[i];
  });
}

void PointwiseUpdate::Iterate(const Roi& region, int iterations, const StructurePrior& prior, float lambda, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  if (inner.empty()) return;
  const int width = buffer->scene.width();
  const int height = buffer->scene.height();
  const int radius = blur_.psf().radius();
  const Roi context = Intersect({inner.x0 - radius, inner.y0 - radius, inner.x1 + radius, inner.y1 + radius}, {0, 0, width, height});
  if (misfit_.width() != width || misfit_.height() != height) misfit_ = Image<float>(width, height);
  std::vector<std::uint32_t> order(static_cast<std::size_t>(inner.area()));
  std::iota(order.begin(), order.end(), 0U);
  for (int sweep = 0; sweep < iterations; ++sweep, ++sweep_count_) {
    // Afresh for each sweep, so that rounding does not add up.
    blur_.Apply(buffer->scene, context, &misfit_);
    for (int y = context.y0; y < context.y1; ++y) {
      for (int x = context.x0; x < context.x1; ++x) {
        misfit_.at(x, y) = buffer->weight.at(x, y) * misfit_.at(x, y) - buffer->weighted.at(x, y);
      }
    }
    Rng rng({seed_, kOrderStream, segment_id_, sweep_count_});
    for (std::size_t i = order.size() - 1; i > 0; --i) std::swap(order[i], order[rng.UniformIndex(static_cast<std::uint32_t>(i + 1))]);
    for (const std::uint32_t cell : order) {
      const int across = static_cast<int>(cell) % inner.width();
      VisitCell(inner.x0 + across, inner.y0 + static_cast<int>(cell) / inner.width(), inner, prior, lambda, buffer);
    }
  }
}

}  // namespace trem
