#include "mosaic/publish/detail_finder.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "mosaic/base/check.h"

namespace trem {
namespace {

constexpr std::size_t kPlacesPerRectangle = 8;

// Mean squared difference of neighbours in the square, which is `margin` larger on each side to be looked at; negative when not covered.
double Energy(const Image<float>& plane, const Roi& square, int margin) {
  double sum = 0.0;
  for (int y = square.y0 - margin; y < square.y1 + margin; ++y) {
    const float* row = plane.row(y);
    const float* next = plane.row(std::min(y + 1, plane.height() - 1));
    const bool inside_y = y >= square.y0 && y < square.y1 - 1;
    for (int x = square.x0 - margin; x < square.x1 + margin; ++x) {
      if (!std::isfinite(row[x])) return -1.0;
      if (!inside_y || x < square.x0 || x >= square.x1 - 1) continue;
      const double right = static_cast<double>(row[x + 1]) - row[x], down = static_cast<double>(next[x]) - row[x];
      sum += right * right + down * down;
    }
  }
  return std::isfinite(sum) ? sum / static_cast<double>(square.area()) : -1.0;
}

bool Far(const Roi& a, const Roi& b, int distance) {
  return std::hypot(0.5 * (a.x0 + a.x1 - b.x0 - b.x1), 0.5 * (a.y0 + a.y1 - b.y0 - b.y1)) >= distance;
}

}  // namespace

void DetailFinder::Add(const Roi& roi, const Image<float>& plane) {
  TREM_CHECK(plane.width() == roi.width() && plane.height() == roi.height() && side_ >= 8);
  const int margin = side_ / 4, step = side_ / 2;
  std::vector<Place> found;
  for (int y = margin; y + side_ + margin <= plane.height(); y += step) {
    for (int x = margin; x + side_ + margin <= plane.width(); x += step) {
      const Roi square{x, y, x + side_, y + side_};
      const double energy = Energy(plane, square, margin);
      if (energy < 0.0) continue;
      found.push_back({energy, {x + roi.x0, y + roi.y0, x + side_ + roi.x0, y + side_ + roi.y0}});
    }
  }
  const auto better = [](const Place& a, const Place& b) {
    return std::tuple(-a.energy, a.roi.y0, a.roi.x0) < std::tuple(-b.energy, b.roi.y0, b.roi.x0);
  };
  std::sort(found.begin(), found.end(), better);
  std::vector<Place> kept;
  for (const Place& place : found) {
    if (kept.size() == kPlacesPerRectangle) break;
    if (std::all_of(kept.begin(), kept.end(), [&](const Place& other) { return Far(place.roi, other.roi, 2 * side_); })) {
      kept.push_back(place);
    }
  }
  places_.insert(places_.end(), kept.begin(), kept.end());
}

std::vector<Roi> DetailFinder::Best(int count) const {
  std::vector<Place> sorted = places_;
  std::sort(sorted.begin(), sorted.end(), [](const Place& a, const Place& b) {
    return std::tuple(-a.energy, a.roi.y0, a.roi.x0) < std::tuple(-b.energy, b.roi.y0, b.roi.x0);
  });
  std::vector<Roi> best;
  for (const Place& place : sorted) {
    if (static_cast<int>(best.size()) == count) break;
    if (std::all_of(best.begin(), best.end(), [&](const Roi& other) { return Far(place.roi, other, 2 * side_); }))
      best.push_back(place.roi);
  }
  return best;
}

}  // namespace trem
