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

// Rectangles about cells that come in row by row.
class Cover {
 public:
  // Cells [begin, end) of row y, not above any that came before.
  void Add(int y, int begin, int end) {
    if (begin >= end) return;
    const Part run{{begin, y, end, y + 1}, end - begin};
    Part* best = nullptr;
    long long least = 0;
    for (Part& part : parts_) {
      const long long waste = Union(part.roi, run.roi).area() - part.roi.area();
      // Rather a rectangle of its own than one that is mostly made of other cells.
      const bool sparse = Union(part.roi, run.roi).area() > 2 * (part.cells + run.cells) + kSpare;
      if ((!sparse || parts_.size() >= kPartsMax) && (best == nullptr || waste < least)) {
        best = &part;
        least = waste;
      }
    }
    if (best == nullptr) {
      parts_.push_back(run);
    } else {
      best->roi = Union(best->roi, run.roi);
      best->cells += run.cells;
    }
  }

  std::vector<Roi> rois() const {
    std::vector<Roi> rois;
    for (const Part& part : parts_) rois.push_back(part.roi);
    return rois;
  }

 private:
  static constexpr std::size_t kPartsMax = 12;
  static constexpr long long kSpare = 64;
  struct Part {
    Roi roi;
    long long cells = 0;
  };

  std::vector<Part> parts_;
};

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

  // Columns [begin, end) of row y of the buffer; of those that are known to be measured, none is looked at.
  void FillRow(int y, int begin, int end) {
    SceneBuffer::Run* const known = &buffer_.measured[static_cast<std::size_t>(y)];
    const SceneBuffer::Run run{std::clamp(known->begin, begin, end), std::clamp(known->end, begin, end)};
    if (run.begin >= run.end) return FillCells(y, begin, end, known);
    FillCells(y, begin, run.begin, known);
    FillCells(y, run.end, end, known);
  }

  std::vector<Roi> changed() const { return changed_.rois(); }

 private:
  // Where a cell lies in the frame, and how far beyond its border: negative on the left and above.
  struct Place {
    double u = 0.0;
    double v = 0.0;
    double beyond_u = 0.0;
    double beyond_v = 0.0;

    bool inside() const { return std::abs(beyond_u) <= kReach && std::abs(beyond_v) <= kReach; }
  };

  // Adds cells [begin, end), which are measured, to a row's run: as they continue it, or in its stead when they are more.
  static void Extend(int begin, int end, SceneBuffer::Run* run) {
    if (begin >= end) return;
    if (run->begin < run->end && begin <= run->end && end >= run->begin) {
      *run = {std::min(begin, run->begin), std::max(end, run->end)};
    } else if (end - begin > run->end - run->begin) {
      *run = {begin, end};
    }
  }

  void FillCells(int y, int begin, int end, SceneBuffer::Run* known) {
    const float* filled = buffer_.filled.row(y);
    for (int x = begin; x < end;) {
      const int first = x + FindUnlike(filled + x, SceneBuffer::kMeasured, end - x);
      Extend(x, first, known);
      x = std::min(first + kGroup, end);
      int last = x;
      while (last > first && filled[last - 1] == SceneBuffer::kMeasured) --last;
      if (first < last && !Continued(filled, first, last, y)) FillGroup(first, last, y);
    }
  }

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

  void FillGroup(int first, int last, int y) {
    int begin = last;
    int end = first;
    for (int x = first; x < last; ++x) {
      if (buffer_.filled.at(x, y) == SceneBuffer::kMeasured || !FillCell(x, y)) continue;
      begin = std::min(begin, x);
      end = x + 1;
    }
    changed_.Add(y, begin, end);
  }

  // Whether the cell's value has changed.
  bool FillCell(int x, int y) {
    const Place place = PlaceOf(x, y);
    bool inside = place.inside();
    if (!inside && buffer_.filled.at(x, y) == SceneBuffer::kContinued) return false;
    Prepare();
    if (holes_) inside = inside && !std::isnan(frame_.pixels.at(static_cast<int>(place.u + 0.5), static_cast<int>(place.v + 0.5)));
    const float source = inside ? SceneBuffer::kMeasured : SceneBuffer::kContinued;
    if (buffer_.filled.at(x, y) == source) return false;
    const float sample = SampleCubic(continued_, place.u, place.v);
    if (std::isnan(sample)) return false;
    buffer_.filled.at(x, y) = source;
    const float value = (sample - static_cast<float>(view_.offset)) / static_cast<float>(view_.gain);
    buffer_.scene.at(x, y) = value;
    buffer_.previous.at(x, y) = value;
    return true;
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
  Cover changed_;
};

}  // namespace

std::vector<Roi> FillUnseen(const FrameInput& frame, const Roi& roi, const View& view, const Roi& region, SceneBuffer* buffer,
                            Image<float>* continued) {
  const Roi inner = buffer->InBuffer(region);
  Filler filler(frame, roi, view, buffer, continued);
  for (int y = inner.y0; y < inner.y1; ++y) filler.FillRow(y, inner.x0, inner.x1);
  return filler.changed();
}

}  // namespace trem
