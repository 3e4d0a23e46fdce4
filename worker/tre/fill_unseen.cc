#include "worker/tre/fill_unseen.h"

#include <algorithm>
#include <cmath>

#include "worker/sensor/bicubic.h"
#include "worker/tre/frame_check.h"
#include "worker/tre/update_kernels.h"

namespace trem {
namespace {

// Cells that are looked at together.
constexpr int kGroup = 16;
// A frame's pixels measure cells up to so far beyond their border [sensor px].
constexpr double kReach = 1.5;

class Filler {
 public:
  Filler(const FrameInput& frame, const Roi& roi, const View& view, SceneBuffer* buffer, Image<float>* continued)
      : frame_(frame),
        roi_(roi),
        view_(view),
        sensor_from_scene_(view.scene_from_sensor.Inverse()),
        buffer_(*buffer),
        continued_(*continued) {
    x_max_ = frame.pixels.width() - 2.001;
    y_max_ = frame.pixels.height() - 2.001;
  }

  // Columns [begin, end) of row y of the buffer.
  void FillRow(int y, int begin, int end) {
    const float* filled = buffer_.filled.row(y);
    for (int x = begin; x < end;) {
      const int first = x + FindUnlike(filled + x, SceneBuffer::kMeasured, end - x);
      x = std::min(first + kGroup, end);
      int last = x;
      while (last > first && filled[last - 1] == SceneBuffer::kMeasured) --last;
      if (first < last && !Continued(filled, first, last, y)) {
        for (int cell = first; cell < last; ++cell) {
          if (filled[cell] != SceneBuffer::kMeasured) FillCell(cell, y);
        }
      }
    }
  }

  Roi changed() const { return changed_; }

 private:
  // Where a cell lies in the frame, and how far beyond its border: negative on the left and above.
  struct Place {
    double u = 0.0;
    double v = 0.0;
    double beyond_u = 0.0;
    double beyond_v = 0.0;

    bool inside() const { return std::abs(beyond_u) <= kReach && std::abs(beyond_v) <= kReach; }
  };

  Place PlaceOf(int x, int y) const {
    const Eigen::Vector2d sensor = sensor_from_scene_ * Eigen::Vector2d(x + buffer_.extent.x0, y + buffer_.extent.y0);
    const double u = sensor.x() - roi_.x0;
    const double v = sensor.y() - roi_.y0;
    Place place{std::clamp(u, 1.0, x_max_), std::clamp(v, 1.0, y_max_)};
    place.beyond_u = u - place.u;
    place.beyond_v = v - place.v;
    return place;
  }

  // Whether cells [first, last) of row y lie beyond the frame, all of them on one side, and hold a continued value already. Both ends tell.
  bool Continued(const float* filled, int first, int last, int y) const {
    if (!view_.scene_from_sensor.IsAffine()) return false;
    if (std::find(filled + first, filled + last, SceneBuffer::kNotFilled) != filled + last) return false;
    const Place a = PlaceOf(first, y);
    const Place b = PlaceOf(last - 1, y);
    return std::min(a.beyond_u, b.beyond_u) > kReach || std::max(a.beyond_u, b.beyond_u) < -kReach ||
           std::min(a.beyond_v, b.beyond_v) > kReach || std::max(a.beyond_v, b.beyond_v) < -kReach;
  }

  void FillCell(int x, int y) {
    const Place place = PlaceOf(x, y);
    bool inside = place.inside();
    if (!inside && buffer_.filled.at(x, y) == SceneBuffer::kContinued) return;
    Prepare();
    if (holes_) inside = inside && !std::isnan(frame_.pixels.at(static_cast<int>(place.u + 0.5), static_cast<int>(place.v + 0.5)));
    const float source = inside ? SceneBuffer::kMeasured : SceneBuffer::kContinued;
    if (buffer_.filled.at(x, y) == source) return;
    const float sample = SampleCubic(continued_, place.u, place.v);
    if (std::isnan(sample)) return;
    buffer_.filled.at(x, y) = source;
    const float value = (sample - static_cast<float>(view_.offset)) / static_cast<float>(view_.gain);
    buffer_.scene.at(x, y) = value;
    buffer_.previous.at(x, y) = value;
    changed_ = changed_.empty()
                   ? Roi{x, y, x + 1, y + 1}
                   : Roi{std::min(changed_.x0, x), std::min(changed_.y0, y), std::max(changed_.x1, x + 1), std::max(changed_.y1, y + 1)};
  }

  // Most frames of a scene show nothing new.
  void Prepare() {
    if (prepared_) return;
    prepared_ = true;
    continued_ = frame_.pixels;
    holes_ = ContinueHoles(&continued_);
  }

  const FrameInput& frame_;
  const Roi& roi_;
  const View& view_;
  PlanarMap sensor_from_scene_;
  SceneBuffer& buffer_;
  Image<float>& continued_;
  double x_max_ = 0.0;
  double y_max_ = 0.0;
  bool prepared_ = false;
  bool holes_ = false;
  Roi changed_{0, 0, 0, 0};
};

}  // namespace

Roi FillUnseen(const FrameInput& frame, const Roi& roi, const View& view, const Roi& region, SceneBuffer* buffer, Image<float>* continued) {
  const Roi inner = buffer->InBuffer(region);
  Filler filler(frame, roi, view, buffer, continued);
  for (int y = inner.y0; y < inner.y1; ++y) filler.FillRow(y, inner.x0, inner.x1);
  return filler.changed();
}

}  // namespace trem
