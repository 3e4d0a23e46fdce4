#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

namespace trem {

// Values at the nodes first + (i, j) * step of a plane, row by row; bilinear between them, constant beyond the outermost ones.
template <typename Value>
struct CellGrid {
  Eigen::Vector2d first = Eigen::Vector2d::Zero();
  double step = 1.0;
  int columns = 0;
  int rows = 0;
  std::vector<Value> values;

  bool empty() const { return values.empty(); }
  Eigen::Vector2d Node(int column, int row) const { return first + step * Eigen::Vector2d(column, row); }

  // Precondition: not empty.
  Value At(const Eigen::Vector2d& x) const {
    const double u = std::clamp((x.x() - first.x()) / step, 0.0, columns - 1.0),
                 v = std::clamp((x.y() - first.y()) / step, 0.0, rows - 1.0);
    const int column = std::min(static_cast<int>(u), std::max(0, columns - 2)), row = std::min(static_cast<int>(v), std::max(0, rows - 2));
    const int right = std::min(column + 1, columns - 1), below = std::min(row + 1, rows - 1);
    const double a = u - column, b = v - row;
    const auto at = [&](int i, int j) {
      return values[static_cast<std::size_t>(j) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(i)];
    };
    const Value top = (1.0 - a) * at(column, row) + a * at(right, row);
    const Value bottom = (1.0 - a) * at(column, below) + a * at(right, below);
    return (1.0 - b) * top + b * bottom;
  }

  // Nodes no further apart than `spacing` over the rectangle from `low` to `high`, at least two along each axis; all values are `value`.
  static CellGrid Over(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double spacing, const Value& value) {
    CellGrid grid;
    grid.first = low;
    grid.step = spacing;
    const Eigen::Vector2d size = high - low;
    grid.columns = std::max(2, static_cast<int>(size.x() / spacing + 0.999999) + 1);
    grid.rows = std::max(2, static_cast<int>(size.y() / spacing + 0.999999) + 1);
    grid.values.assign(static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows), value);
    return grid;
  }
};

// How far relief moves what a scene shows from where its homography has it: a place x of the world is shown by the cell c + At(c),
// c = scene_from_world * x. Cells of the scene's plane.
using CellShifts = CellGrid<Eigen::Vector2d>;

// The cell that shows what the homography has at cell `c`, and back (to 1e-6 cells where the shifts change by less than a half a cell).
inline Eigen::Vector2d Shifted(const CellShifts& shifts, const Eigen::Vector2d& c) {
  return shifts.empty() ? c : Eigen::Vector2d(c + shifts.At(c));
}
inline Eigen::Vector2d Unshifted(const CellShifts& shifts, const Eigen::Vector2d& shown) {
  if (shifts.empty()) return shown;
  constexpr int kIterations = 24;
  Eigen::Vector2d c = shown;
  for (int i = 0; i < kIterations; ++i) {
    const Eigen::Vector2d next = shown - shifts.At(c);
    if ((next - c).squaredNorm() < 1e-14) return next;
    c = next;
  }
  return c;
}
inline double LargestShift(const CellShifts& shifts) {
  double largest = 0.0;
  for (const Eigen::Vector2d& shift : shifts.values) largest = std::max(largest, shift.norm());
  return largest;
}

}  // namespace trem
