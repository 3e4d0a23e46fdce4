#pragma once

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "mosaic/base/image.h"
#include "mosaic/base/rng.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/roi.h"

namespace trem::align {

// Ground with structure at many scales; one texel a sensor pixel.
class Texture {
 public:
  explicit Texture(std::uint64_t seed) : texels_(kSide, kSide, CV_32F, cv::Scalar(0)) {
    for (const double sigma : {1.2, 3.0, 9.0}) {
      cv::Mat octave(kSide, kSide, CV_32F);
      Rng rng({seed, static_cast<std::uint64_t>(10.0 * sigma)});
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) octave.at<float>(y, x) = static_cast<float>(rng.Normal());
      }
      cv::GaussianBlur(octave, octave, cv::Size(), sigma, sigma, cv::BORDER_REFLECT);
      texels_ += octave * (25.0 * sigma);
    }
  }

  Image<float> Render(const Homography& texel_from_scene, const Roi& roi) const {
    Image<float> scene(roi.width(), roi.height());
    for (int y = 0; y < roi.height(); ++y) {
      for (int x = 0; x < roi.width(); ++x) {
        const Eigen::Vector2d at = texel_from_scene * Eigen::Vector2d(roi.x0 + x, roi.y0 + y);
        scene.at(x, y) = 128.0F + Sample(at.x(), at.y());
      }
    }
    return scene;
  }

 private:
  static constexpr int kSide = 1024;

  float Sample(double x, double y) const {
    const double fx = std::floor(x), fy = std::floor(y);
    const auto at = [&](double i, double j) {
      return texels_.at<float>(static_cast<int>(j - kSide * std::floor(j / kSide)), static_cast<int>(i - kSide * std::floor(i / kSide)));
    };
    const auto u = static_cast<float>(x - fx), v = static_cast<float>(y - fy);
    return (1 - v) * ((1 - u) * at(fx, fy) + u * at(fx + 1, fy)) + v * ((1 - u) * at(fx, fy + 1) + u * at(fx + 1, fy + 1));
  }

  cv::Mat texels_;
};

inline Homography TexelFromWorld(double gsd) {
  Homography h;
  h.matrix << 1.0 / gsd, 0.0, 300.0, 0.0, -1.0 / gsd, 300.0, 0.0, 0.0, 1.0;
  return h;
}

}  // namespace trem::align
