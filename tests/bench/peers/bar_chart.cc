#include "tests/bench/peers/bar_chart.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "worker/simulate/truth.h"

namespace trem::bench {
namespace {

constexpr int kCellsPerPixel = 6;
constexpr double kFirstPx = 12.0;  // Of the first board, from the ROI's corner.
constexpr double kPitchPx = BarBoard::kSide + 1.0;
constexpr int kBoardsPerRow = 7;
constexpr double kBorderPx = 2.0;  // Of a board, that is not read.

double Phase(const BarBoard& board, double u, double v) {
  return 2.0 * std::numbers::pi * board.frequency * (board.upright ? u - board.x0 : v - board.y0);
}

// The part of [a, b] where frac(x) < 1/2: bars of one period on the number line.
double Covered(double a, double b) {
  const auto integral = [](double x) {
    const double whole = std::floor(x);
    return 0.5 * whole + std::min(x - whole, 0.5);
  };
  return (integral(b) - integral(a)) / (b - a);
}

void Draw(const BarBoard& board, const Eigen::Vector2d& corner, Image<float>* truth) {
  const double half = 0.5 / kCellsPerPixel;
  for (int y = 0; y < truth->height(); ++y) {
    for (int x = 0; x < truth->width(); ++x) {
      const double u = (x - corner.x()) / kCellsPerPixel;
      const double v = (y - corner.y()) / kCellsPerPixel;
      if (u < board.x0 || v < board.y0 || u >= board.x0 + BarBoard::kSide || v >= board.y0 + BarBoard::kSide) continue;
      const double along = board.upright ? u - board.x0 : v - board.y0;
      const double bright = Covered(board.frequency * (along - half), board.frequency * (along + half));
      truth->at(x, y) = static_cast<float>(BarBoard::kDark + (BarBoard::kBright - BarBoard::kDark) * bright);
    }
  }
}

}  // namespace

BarChart MakeBarChart(testing::SequenceOptions options) {
  options.cells_per_pixel = kCellsPerPixel;
  BarChart chart;
  for (int step = 0; step <= 14; ++step) {
    for (const bool upright : {true, false}) {
      const int place = static_cast<int>(chart.boards.size());
      chart.boards.push_back(
          {kFirstPx + kPitchPx * (place % kBoardsPerRow), kFirstPx + kPitchPx * (place / kBoardsPerRow), 0.30 + 0.05 * step, upright});
    }
  }
  TREM_CHECK(chart.boards.back().y0 + BarBoard::kSide < options.roi_px - 8.0);
  Image<float> truth = ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), options.seed);
  // Frame 0's pixels lie on the truth's cells, its ROI in the truth's middle but for the border.
  const Eigen::Vector2d corner = testing::FirstDwellCorner(options);
  for (const BarBoard& board : chart.boards) Draw(board, corner, &truth);
  chart.scene = MakeBenchScene("bars", false, std::move(truth), options);
  return chart;
}

BarReading ReadBars(const Image<float>& answer, const BarBoard& board) {
  const auto first = [](double px) { return static_cast<int>(std::ceil(BenchScene::kRatio * (px + kBorderPx))); };
  const auto last = [](double px) { return static_cast<int>(std::floor(BenchScene::kRatio * (px + BarBoard::kSide - kBorderPx))); };
  double n = 0.0, sa = 0.0, ss = 0.0, saa = 0.0, sss = 0.0, sas = 0.0;
  for (int y = first(board.y0); y <= last(board.y0); ++y) {
    for (int x = first(board.x0); x <= last(board.x0); ++x) {
      const double a = answer.at(x, y);
      const double s = std::sin(Phase(board, static_cast<double>(x) / BenchScene::kRatio, static_cast<double>(y) / BenchScene::kRatio));
      n += 1.0;
      sa += a;
      ss += s;
      saa += a * a;
      sss += s * s;
      sas += a * s;
    }
  }
  const double covariance = sas - sa * ss / n;
  const double of_sine = sss - ss * ss / n;
  const double of_answer = std::max(saa - sa * sa / n, 1e-9);
  // A square wave between -1 and 1 has a fundamental of 4 / pi.
  const double true_amplitude = 0.5 * (BarBoard::kBright - BarBoard::kDark) * 4.0 / std::numbers::pi;
  return {covariance / of_sine / true_amplitude, covariance / std::sqrt(of_sine * of_answer)};
}

double HighestResolved(const Image<float>& answer, const BarChart& chart) {
  double highest = 0.0;
  for (std::size_t i = 0; i + 1 < chart.boards.size(); i += 2) {
    if (!ReadBars(answer, chart.boards[i]).resolved() || !ReadBars(answer, chart.boards[i + 1]).resolved()) break;
    highest = chart.boards[i].frequency;
  }
  return highest;
}

}  // namespace trem::bench
