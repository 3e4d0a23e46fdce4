#include "tests/bench/peers/bench_scene.h"

#include <algorithm>
#include <cmath>

#include "worker/sensor/bicubic.h"

namespace trem::bench {
namespace {

// Sensor pixels inside frame 0's border that are not scored: the drift takes them out of view, or the PSF reaches over the border.
constexpr double kMarginPx = 8.0;
// How far the random walk strays, nearly always.
constexpr double kWalkPx = 3.0;
constexpr double kShiftReach = 2.0;

Image<float> Shifted(const Image<float>& image, double dx, double dy) {
  Image<float> out(image.width(), image.height());
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) out.at(x, y) = SampleClamped(image, x - dx, y - dy);
  }
  return out;
}

// The truth with three cells a pixel, beginning at (x0, y0) of its own cells, `step` of them apart; smoothed by [1 2 1] / 4 first when
// that drops cells.
Image<float> OnAnswerGrid(const Image<float>& truth, int x0, int y0, int step, int side) {
  const Image<float> smoothed = step > 1 ? testing::Filtered121(truth) : truth;
  Image<float> cut(side, side);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) cut.at(x, y) = smoothed.at(x0 + step * x, y0 + step * y);
  }
  return cut;
}

}  // namespace

Affine BenchScene::SceneFromSensor(int t) const {
  return sequence.TruthFromScene(0).Inverse() * sequence.truth_from_sensor[static_cast<std::size_t>(t)];
}

Image<float> BenchScene::Flattened(int t) const {
  const auto index = static_cast<std::size_t>(t);
  Image<float> frame = sequence.frames[index].pixels;
  for (float& value : frame.pixels()) {
    value = (value - static_cast<float>(sequence.offsets[index])) / static_cast<float>(sequence.gains[index]);
  }
  return frame;
}

BenchScene MakeBenchScene(std::string name, bool natural, Image<float> truth, const testing::SequenceOptions& options) {
  TREM_CHECK(options.motion == testing::CameraMotion::kDwell && options.cells_per_pixel % BenchScene::kRatio == 0);
  BenchScene scene{std::move(name), natural, options, testing::RenderSequence(std::move(truth), options), {}, {}};
  const int step = options.cells_per_pixel / BenchScene::kRatio;
  const Eigen::Vector2d corner = scene.sequence.TruthFromScene(0) * Eigen::Vector2d(0.0, 0.0);
  const int side = scene.AnswerSide();
  // With a cell to spare on every side for the filter.
  const Image<float> seen = OnAnswerGrid(scene.sequence.truth, static_cast<int>(std::lround(corner.x())) - step,
                                         static_cast<int>(std::lround(corner.y())) - step, step, side + 2);
  const Image<float> filtered = testing::Filtered121(seen);
  scene.target = Image<float>(side, side);
  for (int y = 0; y < side; ++y) std::copy_n(filtered.row(y + 1) + 1, side, scene.target.row(y));
  // The camera drifts down and to the right.
  const double drift_px = options.speed_px * options.frame_count;
  const int before = static_cast<int>(std::ceil(BenchScene::kRatio * std::max(kMarginPx, drift_px + kMarginPx - kWalkPx)));
  const int after = static_cast<int>(BenchScene::kRatio * (options.roi_px - 1 - kMarginPx));
  scene.scored = {before, before, after, after};
  TREM_CHECK(!scene.scored.empty());
  return scene;
}

double Score(const BenchScene& scene, const Image<float>& answer) {
  TREM_CHECK(answer.width() == scene.AnswerSide() && answer.height() == scene.AnswerSide());
  std::vector<double> values;
  std::vector<double> truth;
  for (int y = scene.scored.y0; y < scene.scored.y1; ++y) {
    for (int x = scene.scored.x0; x < scene.scored.x1; ++x) {
      values.push_back(answer.at(x, y));
      truth.push_back(scene.target.at(x, y));
    }
  }
  return testing::Psnr(values, truth).value();
}

ShiftedScore ScoreAtBestShift(const BenchScene& scene, const Image<float>& answer, double start_x, double start_y) {
  ShiftedScore best{-1e9, start_x, start_y};
  // A compass search: halve the step when no neighbour is better.
  for (double step = 1.0; step >= 0.05;) {
    const ShiftedScore from = best;
    for (const auto& [i, j] : {std::pair{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
      const double x = from.shift_x + i * step;
      const double y = from.shift_y + j * step;
      if (std::abs(x - start_x) > kShiftReach || std::abs(y - start_y) > kShiftReach) continue;
      const double db = Score(scene, Shifted(answer, x, y));
      if (db > best.db) best = {db, x, y};
    }
    if (best.shift_x == from.shift_x && best.shift_y == from.shift_y) step *= 0.5;
  }
  return best;
}

float SampleClamped(const Image<float>& image, double x, double y) {
  return SampleCubic(image, std::clamp(x, 1.0, image.width() - 2.001), std::clamp(y, 1.0, image.height() - 2.001));
}

Image<float> Bicubic(const BenchScene& scene) {
  const Image<float> frame = scene.Flattened(0);
  Image<float> answer(scene.AnswerSide(), scene.AnswerSide());
  for (int y = 0; y < answer.height(); ++y) {
    for (int x = 0; x < answer.width(); ++x) {
      answer.at(x, y) = SampleClamped(frame, static_cast<double>(x) / BenchScene::kRatio, static_cast<double>(y) / BenchScene::kRatio);
    }
  }
  return answer;
}

}  // namespace trem::bench
