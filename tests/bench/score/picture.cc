#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "tests/bench/score/score.h"

namespace trem::score {
namespace {

constexpr int kCropWidth = 150;
constexpr int kCropHeight = 110;
constexpr int kEnlarge = 3;
constexpr int kRows = 4;
constexpr int kGap = 6;
constexpr int kTitle = 24;

// The crops with the strongest edges that lie wholly on compared pixels and apart from each other, best first. Edges are sought in a
// slightly blurred truth: things (roofs, marks, cars) tell more than grass does.
std::vector<cv::Rect> DetailedPlaces(const Image<float>& sharp) {
  Image<float> truth(sharp.width(), sharp.height());
  cv::Mat blurred(truth.height(), truth.width(), CV_32F, truth.row(0));
  cv::GaussianBlur(cv::Mat(sharp.height(), sharp.width(), CV_32F, const_cast<float*>(sharp.row(0))), blurred, {15, 15}, 2.5);
  struct Place {
    double energy;
    cv::Rect rect;
  };
  std::vector<Place> places;
  for (int y = 1; y + kCropHeight + 1 < truth.height(); y += kCropHeight / 4) {
    for (int x = 1; x + kCropWidth + 1 < truth.width(); x += kCropWidth / 4) {
      double energy = 0.0;
      for (int j = y; j < y + kCropHeight; ++j) {
        for (int i = x; i < x + kCropWidth; ++i)
          energy += std::abs(truth.at(i + 1, j) - truth.at(i, j)) + std::abs(truth.at(i, j + 1) - truth.at(i, j));
      }
      if (std::isfinite(energy)) places.push_back({energy, {x, y, kCropWidth, kCropHeight}});
    }
  }
  std::stable_sort(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.energy > b.energy; });
  std::vector<cv::Rect> chosen;
  for (const Place& place : places) {
    // Twice the size apart, so that the rows show different things.
    const bool apart = std::all_of(chosen.begin(), chosen.end(), [&](const cv::Rect& other) {
      return std::abs(other.x - place.rect.x) >= 2 * kCropWidth || std::abs(other.y - place.rect.y) >= 2 * kCropHeight;
    });
    if (apart) chosen.push_back(place.rect);
    if (static_cast<int>(chosen.size()) == kRows) break;
  }
  return chosen;
}

}  // namespace

Status WritePicture(const Compared& compared, const std::filesystem::path& path) {
  const std::vector<cv::Rect> places = DetailedPlaces(compared.truth);
  if (places.empty()) {
    return InvalidInput("no place of " + std::to_string(kCropWidth) + " x " + std::to_string(kCropHeight) +
                        " compared pixels to show in '" + path.string() + "'");
  }
  const cv::Size crop(kCropWidth * kEnlarge, kCropHeight * kEnlarge);
  cv::Mat picture(kTitle + static_cast<int>(places.size()) * (crop.height + kGap), 3 * (crop.width + kGap) - kGap, CV_8U, cv::Scalar(255));
  const Image<float>* const images[] = {&compared.truth, &compared.bicubic, &compared.mosaic};
  const char* const titles[] = {"truth", "bicubic frame", "mosaic"};
  for (int column = 0; column < 3; ++column) {
    const int x = column * (crop.width + kGap);
    cv::putText(picture, titles[column], {x + 4, kTitle - 7}, cv::FONT_HERSHEY_SIMPLEX, 0.6, cv::Scalar(0), 1, cv::LINE_AA);
    const Image<float>& image = *images[column];
    const cv::Mat whole(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0)));
    for (std::size_t row = 0; row < places.size(); ++row) {
      cv::Mat grey, large;
      whole(places[row]).convertTo(grey, CV_8U);
      cv::resize(grey, large, crop, 0, 0, cv::INTER_NEAREST);
      large.copyTo(picture(cv::Rect(x, kTitle + static_cast<int>(row) * (crop.height + kGap), crop.width, crop.height)));
    }
  }
  try {
    if (cv::imwrite(path.string(), picture)) return {};
  } catch (const cv::Exception& error) {
    return InvalidInput("cannot write picture '" + path.string() + "': " + error.what() + " (the name must end in .png or .jpg)");
  }
  return InvalidInput("cannot write picture '" + path.string() + "'; does its folder exist?");
}

}  // namespace trem::score
