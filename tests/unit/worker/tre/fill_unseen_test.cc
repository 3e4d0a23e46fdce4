// Goal: cells get the frame's value when it shows them, its border's when it does not, keep what a frame has measured, and are named as
// changed. Method: a frame with a hole over a buffer of which a part has been filled before, under views with rotation and perspective;
// every cell is judged by the rule of the header on its own.
#include "worker/tre/fill_unseen.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/unit/worker/sensor/random_image.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/frame_check.h"

namespace trem {
namespace {

const Roi kRoi{10, 20, 51, 55};
const Roi kExtent{-24, -16, 160, 144};
const Roi kRegion{-20, -12, 150, 130};

struct Filled {
  float source;
  float value;
};

class OneByOne {
 public:
  OneByOne(const FrameInput& frame, const View& view) : frame_(frame), view_(view), continued_(frame.pixels) { ContinueHoles(&continued_); }

  // What becomes of a cell of the scene plane that holds `before`.
  Filled Of(int x, int y, const Filled& before) const {
    if (before.source == SceneBuffer::kMeasured) return before;
    const Eigen::Vector2d sensor = view_.scene_from_sensor.Inverse() * Eigen::Vector2d(x, y);
    const double u = std::clamp(sensor.x() - kRoi.x0, 1.0, kRoi.width() - 2.001);
    const double v = std::clamp(sensor.y() - kRoi.y0, 1.0, kRoi.height() - 2.001);
    const bool near = std::abs(sensor.x() - kRoi.x0 - u) <= 1.5 && std::abs(sensor.y() - kRoi.y0 - v) <= 1.5;
    const bool hole = std::isnan(frame_.pixels.at(static_cast<int>(u + 0.5), static_cast<int>(v + 0.5)));
    const float source = near && !hole ? SceneBuffer::kMeasured : SceneBuffer::kContinued;
    if (source == before.source) return before;
    return {source, (SampleCubic(continued_, u, v) - static_cast<float>(view_.offset)) / static_cast<float>(view_.gain)};
  }

 private:
  const FrameInput& frame_;
  const View& view_;
  Image<float> continued_;
};

View ViewOf(double turn, double perspective) {
  View view{{}, 1.2, -7.0};
  view.scene_from_sensor.linear << 3.0, turn, -turn, 2.9;
  view.scene_from_sensor.offset << -26.3, -55.7;
  view.scene_from_sensor.perspective << perspective, -0.5 * perspective;
  return view;
}

TEST(FillUnseen, EveryCellIsFilledByTheRule) {
  FrameInput frame;
  frame.pixels = RandomImage(kRoi.width(), kRoi.height(), 3);
  for (int v = 12; v < 18; ++v) {
    for (int u = 20; u < 27; ++u) frame.pixels.at(u, v) = std::numeric_limits<float>::quiet_NaN();
  }
  for (const View& view : {ViewOf(0.0, 0.0), ViewOf(0.4, 0.0), ViewOf(-0.2, 3e-4)}) {
    SceneBuffer buffer(kExtent);
    for (int y = 0; y < kExtent.height(); ++y) {
      for (int x = 0; x < kExtent.width(); ++x) {
        buffer.filled.at(x, y) = x < 60 ? SceneBuffer::kMeasured : x < 150 ? SceneBuffer::kContinued : SceneBuffer::kNotFilled;
      }
    }
    const SceneBuffer before = buffer;
    Image<float> continued;
    const std::vector<Roi> changed = FillUnseen(frame, kRoi, view, kRegion, &buffer, &continued);
    const OneByOne rule(frame, view);
    long long changes = 0;
    for (int y = 0; y < kExtent.height(); ++y) {
      for (int x = 0; x < kExtent.width(); ++x) {
        Filled cell{before.filled.at(x, y), before.scene.at(x, y)};
        if (kRegion.Contains(x + kExtent.x0, y + kExtent.y0)) cell = rule.Of(x + kExtent.x0, y + kExtent.y0, cell);
        ASSERT_EQ(buffer.filled.at(x, y), cell.source) << x << ", " << y;
        ASSERT_EQ(buffer.scene.at(x, y), cell.value) << x << ", " << y;
        ASSERT_EQ(buffer.previous.at(x, y), cell.value) << x << ", " << y;
        if (cell.source == before.filled.at(x, y)) continue;
        ++changes;
        const auto holds = [x, y](const Roi& part) { return part.Contains(x, y); };
        ASSERT_TRUE(std::any_of(changed.begin(), changed.end(), holds)) << x << ", " << y;
      }
    }
    ASSERT_GT(changes, 0);
    // The rectangles are not mostly made of other cells.
    long long held = 0;
    for (const Roi& part : changed) held += part.area();
    EXPECT_LE(held, 2 * changes + 64 * static_cast<long long>(changed.size()));
    // A second time, nothing is left to do.
    const SceneBuffer after = buffer;
    EXPECT_TRUE(FillUnseen(frame, kRoi, view, kRegion, &buffer, &continued).empty());
    EXPECT_TRUE(std::equal(after.scene.pixels().begin(), after.scene.pixels().end(), buffer.scene.pixels().begin()));
  }
}

}  // namespace
}  // namespace trem
