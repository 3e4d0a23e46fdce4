#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/image.h"

namespace trem::testing {

struct TestVideo {
  std::string encoder = "ffv1";  // Name of a libavcodec encoder.
  std::string pixel_format = "gray";
  int frame_rate_hz = 10;
  int gop_frames = 12;
  int b_frames = 0;
  bool interlaced = false;  // Marks and codes the frames as interlaced, top field first.
  bool full_range = false;
};

// True when this libavcodec has the encoder.
bool HasEncoder(const std::string& name);

// Encodes 8-bit grey frames as a video file whose container follows from the extension (.avi, .mp4, .mkv, .ts). The luma codes are the
// pixels as they are. Fails the calling test on any error.
void WriteVideo(const std::filesystem::path& path, const std::vector<Image<float>>& frames, const TestVideo& options);

// A textured ground, seen through a window at (x, y) of it: frames of a moving camera differ by a known shift. Values 20..235.
Image<float> TexturedFrame(int width, int height, double x, double y, std::uint64_t seed);

}  // namespace trem::testing
