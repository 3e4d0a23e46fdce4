#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "mosaic/base/check.h"
#include "mosaic/base/large_pages.h"

namespace trem {

// A dense single-band raster, row-major, without padding. A value type: copies copy the pixels.
template <typename T>
class Image {
 public:
  Image() = default;
  Image(int width, int height, T value = T{})
      : width_(width), height_(height), pixels_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value) {
    TREM_CHECK(width >= 0 && height >= 0);
  }

  int width() const { return width_; }
  int height() const { return height_; }
  bool empty() const { return pixels_.empty(); }
  T* row(int y) { return pixels_.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(width_); }
  const T* row(int y) const { return pixels_.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(width_); }
  T& at(int x, int y) { return row(y)[x]; }
  const T& at(int x, int y) const { return row(y)[x]; }
  std::span<T> pixels() { return pixels_; }
  std::span<const T> pixels() const { return pixels_; }

 private:
  int width_ = 0;
  int height_ = 0;
  std::vector<T, LargePageAllocator<T>> pixels_;
};

}  // namespace trem
