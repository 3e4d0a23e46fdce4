#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "mosaic/base/check.h"
#include "mosaic/base/rng.h"
#include "worker/simulate/truth.h"

namespace trem {
namespace {

// Everything is drawn twice as fine as asked for and averaged, so that edges fall anywhere between cells.
constexpr int kFine = 2;

enum Purpose : std::uint64_t { kFields = 101, kRoads, kRoofs, kTargets };

// Smooth noise: a coarse grid of normal draws, enlarged with cubic interpolation.
void AddOctave(cv::Mat* ground, double cell, double amplitude, Rng* rng) {
  cv::Mat coarse(static_cast<int>(ground->rows / cell) + 4, static_cast<int>(ground->cols / cell) + 4, CV_32F);
  for (int y = 0; y < coarse.rows; ++y) {
    for (int x = 0; x < coarse.cols; ++x) coarse.at<float>(y, x) = static_cast<float>(amplitude * rng->Normal());
  }
  cv::Mat fine;
  cv::resize(coarse, fine, {static_cast<int>(coarse.cols * cell) + 1, static_cast<int>(coarse.rows * cell) + 1}, 0, 0, cv::INTER_CUBIC);
  *ground += fine(cv::Rect(static_cast<int>(cell), static_cast<int>(cell), ground->cols, ground->rows));
}

// Fields: the nearest of scattered seeds gives a level and the direction and strength of furrows.
void DrawFields(cv::Mat* ground, std::uint64_t seed) {
  Rng rng({seed, kFields});
  struct Field {
    double x, y, level, kx, ky, furrow;
  };
  std::vector<Field> fields(static_cast<std::size_t>(std::max(4.0, ground->total() / (420.0 * 420.0 * kFine * kFine))));
  for (Field& field : fields) {
    const double angle = std::numbers::pi * rng.Uniform();
    const double period = kFine * (7.0 + 14.0 * rng.Uniform());
    field = {ground->cols * rng.Uniform(),
             ground->rows * rng.Uniform(),
             70.0 + 90.0 * rng.Uniform(),
             2.0 * std::numbers::pi * std::cos(angle) / period,
             2.0 * std::numbers::pi * std::sin(angle) / period,
             rng.Uniform() < 0.6 ? 4.0 + 9.0 * rng.Uniform() : 0.0};
  }
  for (int y = 0; y < ground->rows; ++y) {
    auto* row = ground->ptr<float>(y);
    for (int x = 0; x < ground->cols; ++x) {
      const Field* nearest = fields.data();
      double best = 1e300;
      for (const Field& field : fields) {
        const double distance = (x - field.x) * (x - field.x) + (y - field.y) * (y - field.y);
        if (distance < best) {
          best = distance;
          nearest = &field;
        }
      }
      row[x] = static_cast<float>(nearest->level + nearest->furrow * std::sin(nearest->kx * x + nearest->ky * y));
    }
  }
  AddOctave(ground, 48.0 * kFine, 9.0, &rng);
  AddOctave(ground, 12.0 * kFine, 7.0, &rng);
  AddOctave(ground, 4.0 * kFine, 7.0, &rng);
  AddOctave(ground, 2.0 * kFine, 5.0, &rng);
}

void DrawRoads(cv::Mat* ground, std::uint64_t seed) {
  Rng rng({seed, kRoads});
  const int count = 3 + static_cast<int>((ground->cols + ground->rows) / (700 * kFine));
  for (int i = 0; i < count; ++i) {
    const bool across = rng.Uniform() < 0.5;
    const double a = rng.Uniform();
    const double b = a + 0.3 * (rng.Uniform() - 0.5);
    const cv::Point from = across ? cv::Point(0, static_cast<int>(a * ground->rows)) : cv::Point(static_cast<int>(a * ground->cols), 0);
    const cv::Point to =
        across ? cv::Point(ground->cols, static_cast<int>(b * ground->rows)) : cv::Point(static_cast<int>(b * ground->cols), ground->rows);
    const int half_width = kFine * (8 + static_cast<int>(10 * rng.Uniform()));
    cv::line(*ground, from, to, cv::Scalar(60 + 30 * rng.Uniform()), 2 * half_width);
    // A dashed white line in the middle.
    const cv::Point2d step = cv::Point2d(to - from) * (1.0 / std::max(1.0, cv::norm(to - from)));
    for (double s = 0.0; s < cv::norm(to - from); s += 36.0 * kFine) {
      cv::line(*ground, cv::Point2d(from) + step * s, cv::Point2d(from) + step * (s + 18.0 * kFine), cv::Scalar(225), kFine + 1);
    }
  }
}

void FillTurnedBox(cv::Mat* ground, cv::Point2d centre, cv::Point2d half, double angle, double level) {
  const cv::Point2d u(std::cos(angle), std::sin(angle));
  const cv::Point2d v(-u.y, u.x);
  constexpr int kShift = 4;
  std::vector<cv::Point> corners;
  for (const auto& [a, b] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
    const cv::Point2d p = (centre + u * (a * half.x) + v * (b * half.y)) * (1 << kShift);
    corners.emplace_back(static_cast<int>(std::lround(p.x)), static_cast<int>(std::lround(p.y)));
  }
  cv::fillConvexPoly(*ground, corners, cv::Scalar(level), cv::LINE_8, kShift);
}

void DrawRoofs(cv::Mat* ground, std::uint64_t seed) {
  Rng rng({seed, kRoofs});
  const auto count = static_cast<int>(ground->total() / (190.0 * 190.0 * kFine * kFine));
  for (int i = 0; i < count; ++i) {
    const cv::Point2d centre(ground->cols * rng.Uniform(), ground->rows * rng.Uniform());
    const cv::Point2d half(kFine * (14.0 + 26.0 * rng.Uniform()), kFine * (9.0 + 16.0 * rng.Uniform()));
    const double angle = std::numbers::pi * rng.Uniform();
    const double level = 95.0 + 120.0 * rng.Uniform();
    const cv::Point2d across(-std::sin(angle), std::cos(angle));
    FillTurnedBox(ground, centre + cv::Point2d(7.0 * kFine, 9.0 * kFine), half, angle, 28.0);
    FillTurnedBox(ground, centre - across * (0.5 * half.y), {half.x, 0.5 * half.y}, angle, level);
    FillTurnedBox(ground, centre + across * (0.5 * half.y), {half.x, 0.5 * half.y}, angle, 0.7 * level);
    for (int chimney = 0; chimney < 2; ++chimney) {
      const cv::Point2d along(std::cos(angle), std::sin(angle));
      FillTurnedBox(ground, centre + along * ((chimney - 0.5) * half.x), {kFine * 2.0, kFine * 2.0}, angle, 215.0);
    }
  }
}

// Three bars along each axis, in sizes of 1.5 to 6 cells a bar, on a grey board; and a wheel of 36 spokes.
void DrawTargets(cv::Mat* ground, std::uint64_t seed, int boards_min) {
  Rng rng({seed, kTargets});
  const int board = 110 * kFine;
  const int count = std::max(boards_min, static_cast<int>(ground->total() / (600.0 * 600.0 * kFine * kFine)));
  for (int i = 0; i < count; ++i) {
    if (ground->cols <= board || ground->rows <= board) return;
    const int x0 = static_cast<int>((ground->cols - board) * rng.Uniform());
    const int y0 = static_cast<int>((ground->rows - board) * rng.Uniform());
    cv::rectangle(*ground, cv::Rect(x0, y0, board, board), cv::Scalar(i % 2 == 0 ? 45.0 : 128.0), cv::FILLED);
    if (i % 2 == 0) {
      int y = y0 + 4 * kFine;
      for (int bar = 3; bar <= 12; bar += 2, y += 20 * kFine) {  // Bar widths in fine cells.
        for (int k = 0; k < 3; ++k) {
          cv::rectangle(*ground, cv::Rect(x0 + 6 * kFine + 2 * k * bar, y, bar, 16 * kFine), cv::Scalar(210), cv::FILLED);
          if (5 * bar <= 18 * kFine) {
            cv::rectangle(*ground, cv::Rect(x0 + 60 * kFine, y + 2 * k * bar, 40 * kFine, bar), cv::Scalar(210), cv::FILLED);
          }
        }
      }
      continue;
    }
    const double centre = 0.5 * (board - 1);
    for (int y = 0; y < board; ++y) {
      for (int x = 0; x < board; ++x) {
        if (std::hypot(x - centre, y - centre) > 0.46 * board) continue;
        ground->at<float>(y0 + y, x0 + x) = std::sin(36.0 * std::atan2(y - centre, x - centre)) > 0.0 ? 215.0F : 35.0F;
      }
    }
  }
}

}  // namespace

Image<float> ProceduralTerrain(int width_cells, int height_cells, std::uint64_t seed, int boards_min) {
  TREM_CHECK(width_cells >= 64 && height_cells >= 64);
  cv::Mat ground(height_cells * kFine, width_cells * kFine, CV_32F);
  DrawFields(&ground, seed);
  DrawRoads(&ground, seed);
  DrawRoofs(&ground, seed);
  DrawTargets(&ground, seed, boards_min);
  Image<float> terrain(width_cells, height_cells);
  for (int y = 0; y < height_cells; ++y) {
    const auto* upper = ground.ptr<float>(kFine * y);
    const auto* lower = ground.ptr<float>(kFine * y + 1);
    for (int x = 0; x < width_cells; ++x) {
      const float mean = 0.25F * (upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1]);
      terrain.at(x, y) = std::clamp(mean, 0.0F, 255.0F);
    }
  }
  return terrain;
}

}  // namespace trem
