#pragma once

#include <algorithm>
#include <string>

namespace trem {

// A half-open pixel rectangle [x0, x1) x [y0, y1) in one named grid. Pixel (0, 0) is the CENTRE of the upper left pixel, so the
// rectangle holds the pixel centres x0 .. x1 - 1.
struct Roi {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;

  int width() const { return x1 - x0; }
  int height() const { return y1 - y0; }
  bool empty() const { return x1 <= x0 || y1 <= y0; }
  long long area() const { return empty() ? 0 : static_cast<long long>(width()) * height(); }
  bool Contains(int x, int y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
  bool Contains(const Roi& other) const { return other.x0 >= x0 && other.x1 <= x1 && other.y0 >= y0 && other.y1 <= y1; }
  friend bool operator==(const Roi&, const Roi&) = default;
};

inline Roi Intersect(const Roi& a, const Roi& b) {
  return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1), std::min(a.y1, b.y1)};
}

// "[x0,x1)x[y0,y1)".
inline std::string ToString(const Roi& roi) {
  return "[" + std::to_string(roi.x0) + "," + std::to_string(roi.x1) + ")x[" + std::to_string(roi.y0) + "," + std::to_string(roi.y1) + ")";
}

}  // namespace trem
