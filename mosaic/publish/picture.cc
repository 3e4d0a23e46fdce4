#include "mosaic/publish/picture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace trem {
namespace {

Result<std::string> EncodePng(const cv::Mat& bgra) {
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".png", bgra, bytes, {cv::IMWRITE_PNG_COMPRESSION, 6})) {
    return Failed("a picture of " + std::to_string(bgra.cols) + " x " + std::to_string(bgra.rows) + " pixels could not be encoded as PNG");
  }
  return std::string(bytes.begin(), bytes.end());
}

// 0..255 where finite; `seen` is 255 there and 0 elsewhere.
cv::Mat1b Quantise(const Image<float>& picture, const ValueRange& range, cv::Mat1b* seen) {
  // Mid-grey under the transparency, for viewers that ignore it.
  cv::Mat1b grey(picture.height(), picture.width(), static_cast<unsigned char>(128));
  *seen = cv::Mat1b(picture.height(), picture.width(), static_cast<unsigned char>(0));
  const double scale = 255.0 / (range.high - range.low);
  for (int y = 0; y < picture.height(); ++y) {
    const float* row = picture.row(y);
    for (int x = 0; x < picture.width(); ++x) {
      if (!std::isfinite(row[x])) continue;
      grey(y, x) = static_cast<unsigned char>(std::clamp((row[x] - range.low) * scale, 0.0, 255.0) + 0.5);
      (*seen)(y, x) = 255;
    }
  }
  return grey;
}

}  // namespace

Reduction::Reduction(int width, int height, int side_max) {
  TREM_CHECK(width >= 1 && height >= 1 && side_max >= 1);
  factor_ = (std::max(width, height) + side_max - 1) / side_max;
  const int columns = (width + factor_ - 1) / factor_;
  const int rows = (height + factor_ - 1) / factor_;
  sum_ = Image<double>(columns, rows, 0.0);
  count_ = Image<int>(columns, rows, 0);
}

void Reduction::Add(const Roi& roi, const Image<float>& plane) {
  TREM_CHECK(plane.width() == roi.width() && plane.height() == roi.height());
  for (int y = roi.y0; y < roi.y1; ++y) {
    const float* row = plane.row(y - roi.y0);
    double* sum = sum_.row(y / factor_);
    int* count = count_.row(y / factor_);
    for (int x = roi.x0; x < roi.x1; ++x) {
      const float value = row[x - roi.x0];
      if (!std::isfinite(value)) continue;
      sum[x / factor_] += value;
      ++count[x / factor_];
    }
  }
}

Image<float> Reduction::Picture() const {
  Image<float> picture(sum_.width(), sum_.height(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    const int count = count_.pixels()[i];
    if (count > 0) picture.pixels()[i] = static_cast<float>(sum_.pixels()[i] / count);
  }
  return picture;
}

ValueRange QuantileRange(const Image<float>& picture, double low, double high) {
  std::vector<float> values;
  for (const float value : picture.pixels()) {
    if (std::isfinite(value)) values.push_back(value);
  }
  if (values.empty()) return {};
  const auto quantile = [&values](double p) {
    const auto nth = values.begin() + static_cast<std::ptrdiff_t>(p * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), nth, values.end());
    return static_cast<double>(*nth);
  };
  ValueRange range{quantile(low), quantile(high)};
  range.high = std::max(range.high, range.low + 1e-6);
  return range;
}

Result<std::string> GreyPng(const Image<float>& picture, const ValueRange& range) {
  cv::Mat1b seen;
  const cv::Mat1b grey = Quantise(picture, range, &seen);
  cv::Mat bgra;
  cv::merge(std::vector<cv::Mat>{grey, grey, grey, seen}, bgra);
  return EncodePng(bgra);
}

Result<std::string> ColourPng(const Image<float>& picture, const ValueRange& range) {
  cv::Mat1b seen;
  const cv::Mat1b grey = Quantise(picture, range, &seen);
  cv::Mat bgr;
  cv::applyColorMap(grey, bgr, cv::COLORMAP_VIRIDIS);
  std::vector<cv::Mat> planes;
  cv::split(bgr, planes);
  for (cv::Mat& plane : planes) plane.setTo(128, seen == 0);
  planes.push_back(seen);
  cv::Mat bgra;
  cv::merge(planes, bgra);
  return EncodePng(bgra);
}

std::string Base64(const std::string& bytes) {
  constexpr char kAlphabet[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
    unsigned group = 0;
    for (std::size_t k = 0; k < 3; ++k) group = group << 8 | (k < left ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) text += k <= left ? kAlphabet[group >> (18 - 6 * k) & 63u] : '=';
  }
  return text;
}

}  // namespace trem
