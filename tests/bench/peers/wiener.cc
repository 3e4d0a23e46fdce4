#include "tests/bench/peers/wiener.h"

#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace trem::bench {
namespace {

constexpr int kBorder = 40;                // Cells of mirrored border against wrap-around.
constexpr double kCornerFrequency = 0.05;  // Cycles per cell; f0.

double TransferAlong(const PsfParameters& psf, double f) {
  const double sigma = psf.sigma_px * BenchScene::kRatio;
  const double box = psf.fill_factor * BenchScene::kRatio;
  const double x = std::numbers::pi * f * box;
  const double detector = x == 0.0 ? 1.0 : std::sin(x) / x;
  return detector * std::exp(-2.0 * std::pow(std::numbers::pi * sigma * f, 2));
}

double Frequency(int i, int size) { return static_cast<double>(i <= size / 2 ? i : i - size) / size; }

cv::Mat View(const Image<float>& image) { return {image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0))}; }

Image<float> Filtered(const BenchScene& scene, const cv::Mat& spectrum, double k, double power) {
  cv::Mat product = spectrum.clone();
  for (int j = 0; j < product.rows; ++j) {
    const double fy = Frequency(j, product.rows);
    const double hy = TransferAlong(scene.psf(), fy);
    auto* row = product.ptr<cv::Vec2f>(j);
    for (int i = 0; i < product.cols; ++i) {
      const double fx = Frequency(i, product.cols);
      const double h = hy * TransferAlong(scene.psf(), fx);
      const double ratio = k * std::pow(std::hypot(fx, fy) / kCornerFrequency, power);
      const double factor = i == 0 && j == 0 ? 1.0 : h / (h * h + ratio);
      row[i] *= static_cast<float>(factor);
    }
  }
  cv::Mat restored;
  cv::dft(product, restored, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  const int side = scene.AnswerSide();
  Image<float> answer(side, side);
  restored(cv::Rect(kBorder, kBorder, side, side)).copyTo(View(answer));
  return answer;
}

}  // namespace

TunedAnswer TunedWiener(const BenchScene& scene, const Image<float>& blurred) {
  const int side = scene.AnswerSide();
  const int padded_side = cv::getOptimalDFTSize(side + 2 * kBorder);
  cv::Mat padded;
  cv::copyMakeBorder(View(blurred), padded, kBorder, padded_side - side - kBorder, kBorder, padded_side - side - kBorder,
                     cv::BORDER_REFLECT_101);
  cv::Mat spectrum;
  cv::dft(padded, spectrum, cv::DFT_COMPLEX_OUTPUT);
  TunedAnswer best;
  for (const double power : {0.0, 1.0, 2.0, 3.0}) {
    for (double k = 1e-5; k < 2.0; k *= 2.0) {
      Image<float> answer = Filtered(scene, spectrum, k, power);
      const double db = Score(scene, answer);
      if (db > best.db) best = {std::move(answer), db, k};
    }
  }
  return best;
}

Image<float> ShiftAndAdd(const BenchScene& scene) {
  const int side = scene.AnswerSide();
  Image<float> sums(side, side);
  Image<float> counts(side, side);
  for (int t = 0; t < scene.options.frame_count; ++t) {
    const Image<float> frame = scene.Flattened(t);
    const Affine scene_from_sensor = scene.SceneFromSensor(t);
    for (int v = 0; v < frame.height(); ++v) {
      for (int u = 0; u < frame.width(); ++u) {
        const Eigen::Vector2d cell = scene_from_sensor * Eigen::Vector2d(u, v);
        const auto x = static_cast<int>(std::lround(cell.x()));
        const auto y = static_cast<int>(std::lround(cell.y()));
        if (x < 0 || y < 0 || x >= side || y >= side) continue;
        sums.at(x, y) += frame.at(u, v);
        counts.at(x, y) += 1.0F;
      }
    }
  }
  // What lies about an empty cell, weighted by nearness.
  cv::Mat near_sums;
  cv::Mat near_counts;
  cv::GaussianBlur(View(sums), near_sums, {}, 1.0);
  cv::GaussianBlur(View(counts), near_counts, {}, 1.0);
  Image<float> answer = Bicubic(scene);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      if (counts.at(x, y) > 0.0F) {
        answer.at(x, y) = sums.at(x, y) / counts.at(x, y);
      } else if (near_counts.at<float>(y, x) > 1e-3F) {
        answer.at(x, y) = near_sums.at<float>(y, x) / near_counts.at<float>(y, x);
      }
    }
  }
  return answer;
}

}  // namespace trem::bench
