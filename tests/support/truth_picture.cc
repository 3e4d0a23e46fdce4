#include "tests/support/truth_picture.h"

#include <cstdio>
#include <opencv2/imgcodecs.hpp>

namespace trem::testing {

Image<float> ReadTruthPicture(const std::string& path, int x, int y, int width, int height) {
  const cv::Mat whole = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (whole.empty() || x < 0 || y < 0 || x + width > whole.cols || y + height > whole.rows) {
    std::fprintf(stderr, "%s: expected a picture with %d x %d pixels from (%d, %d)\n", path.c_str(), width, height, x, y);
    return {};
  }
  Image<float> truth(width, height);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) truth.at(column, row) = whole.at<unsigned char>(y + row, x + column);
  }
  return truth;
}

}  // namespace trem::testing
