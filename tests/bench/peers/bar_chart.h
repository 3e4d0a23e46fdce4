#pragma once

#include <vector>

#include "tests/bench/peers/bench_scene.h"

namespace trem::bench {

// A square board of bars on frame 0's sensor pixels: grey levels kDark and kBright, as wide as the gaps.
struct BarBoard {
  double x0 = 0.0;  // Upper left corner, sensor pixels of frame 0.
  double y0 = 0.0;
  double frequency = 0.0;  // Bars a sensor pixel; the sensor's Nyquist frequency is 0.5.
  bool upright = false;    // Bars run along y.

  static constexpr double kSide = 17.0;  // Sensor pixels.
  static constexpr double kDark = 40.0;
  static constexpr double kBright = 210.0;
};

struct BarChart {
  std::vector<BarBoard> boards;  // By rising frequency, upright and lying for each.
  BenchScene scene;
};

// Boards of 0.30, 0.35 ... 1.00 bars a pixel on procedural ground, drawn with 6 cells a pixel by exact coverage, so that the bars do not
// depend on the 3:1 grid. `options.roi_px` must hold them: 151 does.
BarChart MakeBarChart(testing::SequenceOptions options);

// How an answer shows a board, at least 2 px inside its border.
struct BarReading {
  double modulation = 0.0;   // Amplitude of the bars' fundamental in the right phase, over the true bars'.
  double correlation = 0.0;  // With that fundamental.
  bool resolved() const { return modulation > 0.1 && correlation > 0.6; }
};
BarReading ReadBars(const Image<float>& answer, const BarBoard& board);

// The highest frequency up to which all boards of both directions are resolved; 0 when not even the first is.
double HighestResolved(const Image<float>& answer, const BarChart& chart);

}  // namespace trem::bench
