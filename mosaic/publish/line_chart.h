#pragma once

#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

struct ChartLine {
  std::string name;       // For the legend; ASCII.
  std::vector<double> x;  // Rising. Same size as y.
  std::vector<double> y;  // A value that is not finite breaks the line.
};

// Lines over a common horizontal axis.
struct LineChart {
  std::string title;  // Texts are ASCII: the drawing font has nothing else.
  std::string x_label;
  std::string y_label;
  std::vector<ChartLine> lines;  // At most 8, told apart by colour and by the order of the legend.
  int width = 640;               // Pixels, at least 320 x 200.
  int height = 300;
};

// Whether any line has a finite value.
bool HasValue(const LineChart& chart);

// An 8-bit RGB PNG: white ground, axes with round numbers that hold all finite values, a legend. The bytes depend on the chart only.
// kInvalidInput when no line has a finite value.
Result<std::string> LineChartPng(const LineChart& chart);

}  // namespace trem
