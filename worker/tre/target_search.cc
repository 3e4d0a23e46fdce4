#include "worker/tre/target_search.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace trem {
namespace {

double MeanOfFinite(const Image<float>& image) {
  double sum = 0.0;
  long long count = 0;
  for (const float value : image.pixels()) {
    if (!std::isfinite(value)) continue;
    sum += value;
    ++count;
  }
  return count > 0 ? sum / static_cast<double>(count) : 0.0;
}

// A copy without NaN; `mask` (may be null) is 1 where the image is finite.
cv::Mat1f Filled(const Image<float>& image, cv::Mat1f* mask) {
  const float mean = static_cast<float>(MeanOfFinite(image));
  cv::Mat1f filled(image.height(), image.width());
  if (mask != nullptr) *mask = cv::Mat1f(image.height(), image.width());
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      const bool finite = std::isfinite(image.at(x, y));
      // Values about 0 keep the sums of the correlation free of cancellation.
      filled(y, x) = finite ? image.at(x, y) - mean : 0.0F;
      if (mask != nullptr) (*mask)(y, x) = finite ? 1.0F : 0.0F;
    }
  }
  return filled;
}

bool HasTexture(const cv::Mat1f& picture, const cv::Mat1f& mask) {
  const double count = cv::sum(mask)[0];
  return count >= 16.0 && cv::norm(picture, cv::NORM_L2SQR) > 0.25 * count;
}

}  // namespace

std::vector<Sighting> FindPicture(const Image<float>& picture, const Image<float>& frame, int count_max) {
  std::vector<Sighting> sightings;
  if (picture.width() > frame.width() || picture.height() > frame.height()) return sightings;
  cv::Mat1f mask;
  const cv::Mat1f wanted = Filled(picture, &mask);
  if (!HasTexture(wanted, mask)) return sightings;
  cv::Mat1f score;
  cv::matchTemplate(Filled(frame, nullptr), wanted, score, cv::TM_CCOEFF_NORMED, mask);
  // Flat stretches of a frame divide nothing by nothing.
  for (float& value : score) {
    if (!(std::abs(value) <= 1.001F)) value = -1.0F;
  }
  const int reach_x = picture.width() / 2;
  const int reach_y = picture.height() / 2;
  while (static_cast<int>(sightings.size()) < count_max) {
    double best = 0.0;
    cv::Point at;
    cv::minMaxLoc(score, nullptr, &best, nullptr, &at);
    if (best <= 0.0) break;
    sightings.push_back({at.x, at.y, best});
    const cv::Rect around(at.x - reach_x, at.y - reach_y, 2 * reach_x + 1, 2 * reach_y + 1);
    score(around & cv::Rect(0, 0, score.cols, score.rows)) = -1.0F;
  }
  return sightings;
}

}  // namespace trem
