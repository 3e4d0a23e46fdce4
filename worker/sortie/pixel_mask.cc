#include "worker/sortie/pixel_mask.h"

#include <algorithm>
#include <array>
#include <opencv2/imgproc.hpp>
#include <string>

#include "worker/sortie/image_sequence_reader.h"

namespace trem {
namespace {

constexpr std::array<int, 4> kSides_px = {3, 9, 33, 129};

// Clears `usable` where `is_unusable(value)`.
template <typename IsUnusable>
Status Apply(const char* field, const std::string& path, IsUnusable is_unusable, Image<std::uint8_t>* usable) {
  const std::string subject = std::string("sensor.") + field + ": " + path;
  const std::string extension = std::filesystem::path(path).extension().string();
  if (extension == ".jpg" || extension == ".jpeg" || extension == ".JPG" || extension == ".JPEG") {
    return InvalidInput(subject + " is a JPEG, whose compression changes values; expected a PNG or TIFF");
  }
  const Result<ImageSize> size = ReadImageSize(path);
  if (!size.ok()) return size.status().WithPrefix(std::string("sensor.") + field);
  if (size->width_px != usable->width() || size->height_px != usable->height()) {
    return InvalidInput(subject + " is " + std::to_string(size->width_px) + " x " + std::to_string(size->height_px) + " pixels; expected " +
                        std::to_string(usable->width()) + " x " + std::to_string(usable->height()) + " like the frames");
  }
  const Result<GreyImage> image = ReadGreyImage(path);
  if (!image.ok()) return image.status().WithPrefix(std::string("sensor.") + field);
  for (std::size_t i = 0; i < usable->pixels().size(); ++i) {
    if (is_unusable(image->pixels.pixels()[i])) usable->pixels()[i] = 0;
  }
  return {};
}

cv::Mat ToMat(const Image<float>& image) {
  // A header over the image's own pixels, which OpenCV only reads here.
  return cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0)));
}

cv::Mat BoxSum(const cv::Mat& image, int side_px) {
  cv::Mat sum;
  cv::boxFilter(image, sum, CV_32F, cv::Size(side_px, side_px), cv::Point(-1, -1), false, cv::BORDER_CONSTANT);
  return sum;
}

}  // namespace

Result<std::optional<PixelMask>> ReadPixelMask(const v1::Sensor& sensor, int width_px, int height_px) {
  if (sensor.mask_path().empty() && sensor.bad_pixel_path().empty()) return std::optional<PixelMask>();
  PixelMask mask;
  mask.usable = Image<std::uint8_t>(width_px, height_px, 1);
  if (!sensor.mask_path().empty()) {
    TREM_RETURN_IF_ERROR(Apply("mask_path", sensor.mask_path(), [](float value) { return value == 0.0F; }, &mask.usable));
  }
  if (!sensor.bad_pixel_path().empty()) {
    TREM_RETURN_IF_ERROR(Apply("bad_pixel_path", sensor.bad_pixel_path(), [](float value) { return value != 0.0F; }, &mask.usable));
  }
  Roi bounds{width_px, height_px, 0, 0};
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      if (mask.usable.at(x, y) == 0) {
        ++mask.unusable_count;
        continue;
      }
      bounds = {std::min(bounds.x0, x), std::min(bounds.y0, y), std::max(bounds.x1, x + 1), std::max(bounds.y1, y + 1)};
    }
  }
  if (bounds.empty()) {
    return InvalidInput("sensor.mask_path and sensor.bad_pixel_path leave no pixel to use; in the mask 0 means no image, in the other 0 means good");
  }
  mask.usable_bounds = bounds;
  return std::optional<PixelMask>(std::move(mask));
}

std::vector<std::uint32_t> RunsOf(const PixelMask& mask) {
  std::vector<std::uint32_t> runs{0};
  std::uint8_t value = 1;
  for (const std::uint8_t pixel : mask.usable.pixels()) {
    if (pixel != value) {
      runs.push_back(0);
      value = pixel;
    }
    ++runs.back();
  }
  return runs;
}

Result<Image<std::uint8_t>> UsableFromRuns(std::span<const std::uint32_t> runs, int width_px, int height_px) {
  Image<std::uint8_t> usable(width_px, height_px, 1);
  std::uint64_t at = 0;
  std::uint8_t value = 1;
  for (const std::uint32_t run : runs) {
    if (at + run > usable.pixels().size()) break;
    std::fill_n(usable.pixels().begin() + static_cast<std::ptrdiff_t>(at), run, value);
    at += run;
    value = static_cast<std::uint8_t>(1 - value);
  }
  if (at != usable.pixels().size()) return Corrupt("manifest.sensor.unusable_runs do not add up to the sensor's pixels");
  return usable;
}

MaskFiller::MaskFiller(const PixelMask& mask) : usable_(mask.usable.width(), mask.usable.height()) {
  std::copy(mask.usable.pixels().begin(), mask.usable.pixels().end(), usable_.pixels().begin());
  for (std::uint32_t i = 0; i < usable_.pixels().size(); ++i) {
    if (usable_.pixels()[i] == 0.0F) others_.push_back(i);
  }
  for (const int side_px : kSides_px) {
    if (others_.empty()) break;
    const cv::Mat counts = BoxSum(ToMat(usable_), side_px);
    Scale scale;
    scale.side_px = side_px;
    std::erase_if(others_, [&](std::uint32_t i) {
      const float count = counts.at<float>(static_cast<int>(i) / usable_.width(), static_cast<int>(i) % usable_.width());
      if (count < 0.5F) return false;
      scale.pixels.push_back(i);
      scale.usable_counts.push_back(count);
      return true;
    });
    if (!scale.pixels.empty()) scales_.push_back(std::move(scale));
  }
}

void MaskFiller::Fill(Image<float>* frame) const {
  TREM_CHECK(frame->width() == usable_.width() && frame->height() == usable_.height());
  const cv::Mat known = ToMat(*frame).mul(ToMat(usable_));
  for (const Scale& scale : scales_) {
    const cv::Mat sums = BoxSum(known, scale.side_px);
    for (std::size_t k = 0; k < scale.pixels.size(); ++k) {
      const int i = static_cast<int>(scale.pixels[k]);
      frame->pixels()[scale.pixels[k]] = sums.at<float>(i / frame->width(), i % frame->width()) / scale.usable_counts[k];
    }
  }
  if (others_.empty()) return;
  const auto mean = static_cast<float>(cv::sum(known)[0] / cv::sum(ToMat(usable_))[0]);
  for (const std::uint32_t i : others_) frame->pixels()[i] = mean;
}

}  // namespace trem
