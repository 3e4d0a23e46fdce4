#include "mosaic/publish/line_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "mosaic/base/check.h"

namespace trem {
namespace {

constexpr int kLeft = 70;
constexpr int kRight = 16;
constexpr int kTop = 52;  // Title and legend.
constexpr int kBottom = 44;
constexpr int kLegendRow = 20;   // Height.
constexpr int kLegendLine = 26;  // Of colour before a name, with the space after it.
constexpr int kLegendGap = 14;   // Before the line.
constexpr double kTextScale = 0.4;
constexpr int kShift = 4;  // Bits of a pixel's fraction in drawn coordinates.
const cv::Scalar kInk(40, 40, 40);
const cv::Scalar kGrid(225, 225, 225);
// Okabe and Ito's palette for all kinds of colour vision, as blue, green, red.
const cv::Scalar kColours[] = {{178, 114, 0},  {0, 94, 213},  {115, 158, 0},  {167, 121, 204},
                               {233, 180, 86}, {0, 159, 230}, {66, 228, 240}, {0, 0, 0}};

struct Axis {
  double low = 0.0;
  double high = 1.0;
  double step = 0.2;

  double Part(double value) const { return (value - low) / (high - low); }
};

// The least of 1, 2, 5 times a power of ten that cuts [low, high] into at most `parts`.
Axis RoundAxis(double low, double high, int parts) {
  if (high - low < 1e-12 * std::max(1.0, std::abs(high))) {
    const double room = std::max(1e-6, 0.1 * std::abs(high));
    low -= room;
    high += room;
  }
  const double least = (high - low) / parts;
  double step = std::pow(10.0, std::floor(std::log10(least)));
  for (const double factor : {2.0, 2.5, 2.0}) {
    if (step >= least) break;
    step *= factor;
  }
  return {std::floor(low / step + 1e-9) * step, std::ceil(high / step - 1e-9) * step, step};
}

void Text(cv::Mat* canvas, const std::string& text, cv::Point at, double scale = kTextScale) {
  cv::putText(*canvas, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, kInk, 1, cv::LINE_AA);
}

int TextWidth(const std::string& text, double scale = kTextScale) {
  int baseline = 0;
  return cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, 1, &baseline).width;
}

std::string Number(double value, double step) {
  const int digits = std::clamp(static_cast<int>(std::ceil(-std::log10(step) - 1e-9)), 0, 9);
  return fmt::format("{:.{}f}", std::abs(value) < 0.5 * std::pow(10.0, -digits) ? 0.0 : value, digits);
}

class Plot {
 public:
  Plot(const LineChart& chart, const Axis& x, const Axis& y)
      : chart_(chart),
        x_(x),
        y_(y),
        top_(LegendWidth() + 6 + TextWidth(chart.y_label) > chart.width - kRight ? kTop + kLegendRow : kTop),
        canvas_(chart.height, chart.width, CV_8UC3, cv::Scalar(255, 255, 255)) {}

  const cv::Mat& Draw() {
    DrawAxes();
    for (std::size_t i = 0; i < chart_.lines.size(); ++i) DrawLine(chart_.lines[i], kColours[i]);
    DrawLegend();
    return canvas_;
  }

 private:
  int PlotWidth() const { return chart_.width - kLeft - kRight; }
  int PlotHeight() const { return chart_.height - top_ - kBottom; }
  int LegendWidth() const {
    int width = 0;
    for (const ChartLine& line : chart_.lines) width += TextWidth(line.name) + kLegendLine + kLegendGap;
    return width;
  }
  double Column(double x) const { return kLeft + x_.Part(x) * PlotWidth(); }
  double Row(double y) const { return top_ + (1.0 - y_.Part(y)) * PlotHeight(); }

  void DrawAxes() {
    for (int k = 0; x_.low + k * x_.step <= x_.high + 1e-9 * x_.step; ++k) {
      const double value = x_.low + k * x_.step;
      const int column = static_cast<int>(std::lround(Column(value)));
      cv::line(canvas_, {column, top_}, {column, top_ + PlotHeight()}, kGrid);
      const std::string text = Number(value, x_.step);
      Text(&canvas_, text, {column - TextWidth(text) / 2, top_ + PlotHeight() + 16});
    }
    for (int k = 0; y_.low + k * y_.step <= y_.high + 1e-9 * y_.step; ++k) {
      const double value = y_.low + k * y_.step;
      const int row = static_cast<int>(std::lround(Row(value)));
      cv::line(canvas_, {kLeft, row}, {kLeft + PlotWidth(), row}, kGrid);
      const std::string text = Number(value, y_.step);
      Text(&canvas_, text, {kLeft - 6 - TextWidth(text), row + 4});
    }
    cv::rectangle(canvas_, cv::Rect(kLeft, top_, PlotWidth() + 1, PlotHeight() + 1), kInk);
    Text(&canvas_, chart_.title, {kLeft, 18}, 0.48);
    Text(&canvas_, chart_.x_label, {kLeft + (PlotWidth() - TextWidth(chart_.x_label)) / 2, chart_.height - 10});
    Text(&canvas_, chart_.y_label, {6, 38});
  }

  void DrawLine(const ChartLine& line, const cv::Scalar& colour) {
    const auto at = [&](std::size_t i) {
      constexpr double kUnit = 1 << kShift;
      return cv::Point(static_cast<int>(std::lround(kUnit * Column(line.x[i]))), static_cast<int>(std::lround(kUnit * Row(line.y[i]))));
    };
    for (std::size_t i = 1; i < line.x.size(); ++i) {
      if (std::isfinite(line.y[i - 1]) && std::isfinite(line.y[i])) cv::line(canvas_, at(i - 1), at(i), colour, 1, cv::LINE_AA, kShift);
    }
  }

  void DrawLegend() {
    int column = kLeft + PlotWidth();
    for (std::size_t i = chart_.lines.size(); i > 0; --i) {
      const std::string& name = chart_.lines[i - 1].name;
      column -= TextWidth(name);
      Text(&canvas_, name, {column, top_ - 10});
      column -= kLegendLine;
      cv::line(canvas_, {column, top_ - 14}, {column + 20, top_ - 14}, kColours[i - 1], 2, cv::LINE_AA);
      column -= kLegendGap;
    }
  }

  const LineChart& chart_;
  Axis x_;
  Axis y_;
  int top_;  // Row of the plot's upper edge: the legend stands above it, below the label of the axis where both do not fit in a row.
  cv::Mat canvas_;
};

}  // namespace

bool HasValue(const LineChart& chart) {
  return std::any_of(chart.lines.begin(), chart.lines.end(), [](const ChartLine& line) {
    return std::any_of(line.y.begin(), line.y.end(), [](double y) { return std::isfinite(y); });
  });
}

Result<std::string> LineChartPng(const LineChart& chart) {
  TREM_CHECK(chart.width >= 320 && chart.height >= 200 && chart.lines.size() <= std::size(kColours));
  double x_low = HUGE_VAL, x_high = -HUGE_VAL, y_low = HUGE_VAL, y_high = -HUGE_VAL;
  for (const ChartLine& line : chart.lines) {
    TREM_CHECK(line.x.size() == line.y.size());
    for (std::size_t i = 0; i < line.x.size(); ++i) {
      if (!std::isfinite(line.y[i])) continue;
      x_low = std::min(x_low, line.x[i]);
      x_high = std::max(x_high, line.x[i]);
      y_low = std::min(y_low, line.y[i]);
      y_high = std::max(y_high, line.y[i]);
    }
  }
  if (!(x_low <= x_high)) return InvalidInput("chart \"" + chart.title + "\" has no finite value to draw");
  const cv::Mat canvas = Plot(chart, RoundAxis(x_low, x_high, 10), RoundAxis(y_low, y_high, 6)).Draw();
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".png", canvas, bytes, {cv::IMWRITE_PNG_COMPRESSION, 9})) return Failed("a chart could not be encoded as PNG");
  return std::string(bytes.begin(), bytes.end());
}

}  // namespace trem
