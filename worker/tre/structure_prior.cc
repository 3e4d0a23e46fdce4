#include "worker/tre/structure_prior.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

namespace trem {
namespace {

// Bilateral TV: every pair of cells once (half plane of shifts). Weights are 0.7^(|l| + |m|).
struct Shift {
  int x;
  int y;
  float weight;
};
constexpr std::array<Shift, 12> kShifts = {{{1, 0, 0.7F},
                                            {0, 1, 0.7F},
                                            {1, 1, 0.49F},
                                            {-1, 1, 0.49F},
                                            {2, 0, 0.49F},
                                            {0, 2, 0.49F},
                                            {2, 1, 0.343F},
                                            {-2, 1, 0.343F},
                                            {1, 2, 0.343F},
                                            {-1, 2, 0.343F},
                                            {2, 2, 0.2401F},
                                            {-2, 2, 0.2401F}}};

float Clip(float value, float limit) { return std::min(std::max(value, -limit), limit); }

void AddDifferences(const Image<float>& scene, const Roi& region, float weight, float limit, Image<float>* gradient) {
  const auto slope = [limit, weight](float difference) { return weight * Clip(difference, limit); };
  for (int y = region.y0; y < region.y1; ++y) {
    const float* row = scene.row(y);
    const float* above = y > region.y0 ? scene.row(y - 1) : row;
    const float* below = y + 1 < region.y1 ? scene.row(y + 1) : row;
    float* out = gradient->row(y);
    const auto vertical = [&](int x) { return slope(row[x] - above[x]) + slope(row[x] - below[x]); };
    const int last = region.x1 - 1;
    out[region.x0] += vertical(region.x0) + (last > region.x0 ? slope(row[region.x0] - row[region.x0 + 1]) : 0.0F);
    for (int x = region.x0 + 1; x < last; ++x) out[x] += vertical(x) + slope(row[x] - row[x - 1]) + slope(row[x] - row[x + 1]);
    if (last > region.x0) out[last] += vertical(last) + slope(row[last] - row[last - 1]);
  }
}

// Sum of the differences to the neighbours that lie in the region: the 5-point Laplacian with a free border, a symmetric operator.
float LaplacianAt(const Image<float>& scene, const Roi& region, int x, int y) {
  const float centre = scene.at(x, y);
  float sum = 0.0F;
  if (x > region.x0) sum += centre - scene.at(x - 1, y);
  if (x + 1 < region.x1) sum += centre - scene.at(x + 1, y);
  if (y > region.y0) sum += centre - scene.at(x, y - 1);
  if (y + 1 < region.y1) sum += centre - scene.at(x, y + 1);
  return sum;
}

int NeighbourCount(const Roi& region, int x, int y) {
  return (x > region.x0 ? 1 : 0) + (x + 1 < region.x1 ? 1 : 0) + (y > region.y0 ? 1 : 0) + (y + 1 < region.y1 ? 1 : 0);
}

void AddLaplacian(const Image<float>& scene, const Roi& region, float weight, Image<float>* gradient) {
  const Roi local{0, 0, region.width(), region.height()};
  Image<float> bends(local.width(), local.height());
  for (int y = 0; y < local.y1; ++y) {
    for (int x = 0; x < local.x1; ++x) bends.at(x, y) = LaplacianAt(scene, region, region.x0 + x, region.y0 + y);
  }
  for (int y = 0; y < local.y1; ++y) {
    float* out = gradient->row(region.y0 + y) + region.x0;
    for (int x = 0; x < local.x1; ++x) out[x] += weight * LaplacianAt(bends, local, x, y);
  }
}

void AddShifts(const Image<float>& scene, const Roi& region, float weight, float limit, Image<float>* gradient) {
  for (const Shift& shift : kShifts) {
    const float factor = weight * shift.weight;
    const int x_begin = region.x0 + std::max(0, -shift.x);
    const int x_end = region.x1 - std::max(0, shift.x);
    for (int y = region.y0; y + shift.y < region.y1; ++y) {
      const float* row = scene.row(y);
      const float* other = scene.row(y + shift.y) + shift.x;
      float* out = gradient->row(y);
      float* other_out = gradient->row(y + shift.y) + shift.x;
      for (int x = x_begin; x < x_end; ++x) {
        const float slope = factor * Clip(row[x] - other[x], limit);
        out[x] += slope;
        other_out[x] -= slope;
      }
    }
  }
}

// Adds the pair of a cell and its neighbour; Huber's psi lies below the parabola of curvature min(1, delta / |d|) that touches it.
void AddPair(float difference, float weight, float limit, CellSlope* sum) {
  const float size = std::abs(difference);
  const float curvature = size > limit ? limit / size : 1.0F;
  sum->slope += weight * curvature * difference;
  sum->curvature += weight * curvature;
}

CellSlope LaplacianSlopeAt(const Image<float>& scene, const Roi& region, int x, int y) {
  const int count = NeighbourCount(region, x, y);
  CellSlope sum;
  sum.slope = static_cast<float>(count) * LaplacianAt(scene, region, x, y);
  sum.curvature = static_cast<float>(count * count + count);
  if (x > region.x0) sum.slope -= LaplacianAt(scene, region, x - 1, y);
  if (x + 1 < region.x1) sum.slope -= LaplacianAt(scene, region, x + 1, y);
  if (y > region.y0) sum.slope -= LaplacianAt(scene, region, x, y - 1);
  if (y + 1 < region.y1) sum.slope -= LaplacianAt(scene, region, x, y + 1);
  return sum;
}

}  // namespace

void StructurePrior::AddGradient(const Image<float>& scene, const Roi& region, float weight, Image<float>* gradient) const {
  switch (kind) {
    case StructurePriorKind::kHuberTv:
      AddDifferences(scene, region, weight, delta, gradient);
      break;
    case StructurePriorKind::kMembrane:
      AddDifferences(scene, region, weight, std::numeric_limits<float>::max(), gradient);
      break;
    case StructurePriorKind::kLaplacian:
      AddLaplacian(scene, region, weight, gradient);
      break;
    case StructurePriorKind::kBilateralTv:
      AddShifts(scene, region, weight, delta, gradient);
      break;
  }
}

CellSlope StructurePrior::SlopeAt(const Image<float>& scene, const Roi& region, int x, int y) const {
  if (kind == StructurePriorKind::kLaplacian) return LaplacianSlopeAt(scene, region, x, y);
  CellSlope sum;
  const float centre = scene.at(x, y);
  const auto add = [&](int other_x, int other_y, float weight, float limit) {
    if (region.Contains(other_x, other_y)) AddPair(centre - scene.at(other_x, other_y), weight, limit, &sum);
  };
  if (kind == StructurePriorKind::kBilateralTv) {
    for (const Shift& shift : kShifts) {
      add(x + shift.x, y + shift.y, shift.weight, delta);
      add(x - shift.x, y - shift.y, shift.weight, delta);
    }
    return sum;
  }
  const float limit = kind == StructurePriorKind::kHuberTv ? delta : std::numeric_limits<float>::max();
  add(x - 1, y, 1.0F, limit);
  add(x + 1, y, 1.0F, limit);
  add(x, y - 1, 1.0F, limit);
  add(x, y + 1, 1.0F, limit);
  return sum;
}

float StructurePrior::curvature_max() const {
  switch (kind) {
    case StructurePriorKind::kHuberTv:
    case StructurePriorKind::kMembrane:
      return kCurvatureMax;
    case StructurePriorKind::kLaplacian:
      return 64.0F;
    case StructurePriorKind::kBilateralTv:
      break;
  }
  float sum = 0.0F;
  for (const Shift& shift : kShifts) sum += shift.weight;
  return 4.0F * sum;
}

}  // namespace trem
