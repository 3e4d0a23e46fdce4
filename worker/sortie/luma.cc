#include "worker/sortie/luma.h"

extern "C" {
#include <libavutil/frame.h>
#include <libavutil/pixdesc.h>
}

#include <algorithm>
#include <string>
#include <vector>

namespace trem {
namespace {

bool IsFullRange(const AVFrame& frame, const AVPixFmtDescriptor& format) {
  if ((format.flags & AV_PIX_FMT_FLAG_RGB) != 0) return true;
  if (frame.color_range == AVCOL_RANGE_JPEG) return true;
  if (frame.color_range == AVCOL_RANGE_MPEG) return false;
  // Unmarked: grey formats come from cameras and lossless codecs and use every level; yuvj formats say so in their name; video does not.
  return format.nb_components <= 2 || std::string(format.name).starts_with("yuvj");
}

// Component `component` of row `y` as integers of the format's own depth.
void ReadRow(const AVFrame& frame, const AVPixFmtDescriptor& format, int y, int component, std::vector<std::uint16_t>* row) {
  const int is_palette = (format.flags & AV_PIX_FMT_FLAG_PAL) != 0 ? 1 : 0;
  av_read_image_line2(row->data(), const_cast<const std::uint8_t**>(frame.data), frame.linesize, &format, 0, y, component, frame.width,
                      is_palette, sizeof(std::uint16_t));
}

}  // namespace

Result<GreyImage> GreyFromVideoFrame(const AVFrame& frame) {
  const AVPixFmtDescriptor* format = av_pix_fmt_desc_get(static_cast<AVPixelFormat>(frame.format));
  constexpr auto kUnsupported = AV_PIX_FMT_FLAG_HWACCEL | AV_PIX_FMT_FLAG_BAYER | AV_PIX_FMT_FLAG_FLOAT;
  if (format == nullptr || (format->flags & kUnsupported) != 0 || format->comp[0].depth < 8 || format->comp[0].depth > 16 ||
      std::string(format->name).starts_with("xyz")) {
    return InvalidInput(std::string("pixel format ") + (format == nullptr ? "unknown" : format->name) +
                        " is not supported; expected grey, YUV or RGB with 8 to 16 bits");
  }
  if (frame.width > kImageSideMax_px || frame.height > kImageSideMax_px ||
      static_cast<long long>(frame.width) * frame.height > kImageAreaMax_px) {
    return InvalidInput("the picture is " + std::to_string(frame.width) + " x " + std::to_string(frame.height) +
                        " pixels; expected at most " + std::to_string(kImageSideMax_px) + " a side");
  }
  const bool is_palette = (format->flags & AV_PIX_FMT_FLAG_PAL) != 0;
  const bool is_rgb = is_palette || (format->flags & AV_PIX_FMT_FLAG_RGB) != 0;
  const int depth = format->comp[0].depth;
  GreyImage image;
  image.grey_max = depth > 8 ? 65535.0 : 255.0;
  image.pixels = Image<float>(frame.width, frame.height);
  const auto unit = static_cast<double>(1 << (depth - 8));
  const bool full = is_rgb || IsFullRange(frame, *format);
  const double black = full ? 0.0 : 16.0 * unit;
  const double white = full ? static_cast<double>((1 << depth) - 1) : 235.0 * unit;
  const auto scale = static_cast<float>(image.grey_max / (white - black));
  const auto offset = static_cast<float>(-black * image.grey_max / (white - black));
  const auto grey_max = static_cast<float>(image.grey_max);
  std::vector<std::uint16_t> first(static_cast<std::size_t>(frame.width));
  std::vector<std::uint16_t> green(is_rgb ? first.size() : 0);
  std::vector<std::uint16_t> blue(green.size());
  for (int y = 0; y < frame.height; ++y) {
    // A palette's entries are stored as blue, green, red, alpha.
    ReadRow(frame, *format, y, is_palette ? 2 : 0, &first);
    if (is_rgb) {
      ReadRow(frame, *format, y, 1, &green);
      ReadRow(frame, *format, y, is_palette ? 0 : 2, &blue);
    }
    float* out = image.pixels.row(y);
    for (std::size_t x = 0; x < first.size(); ++x) {
      const float value = is_rgb ? Luminance(first[x], green[x], blue[x]) : static_cast<float>(first[x]);
      out[x] = std::clamp(value * scale + offset, 0.0F, grey_max);
    }
  }
  return image;
}

}  // namespace trem
