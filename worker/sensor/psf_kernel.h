#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// A measured point spread function: the response to a point source, sampled samples_per_pixel times a sensor pixel along both axes,
// detector included. Row-major, x to the right, y down, in the sense of the image.
struct PsfKernel {
  int width = 0;
  int height = 0;
  double samples_per_pixel = 0.0;
  std::vector<float> values;  // width * height.

  float at(int x, int y) const { return values[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)]; }
};

inline constexpr int kKernelSideMax = 256;
inline constexpr std::size_t kKernelFileBytesMax = std::size_t{1} << 21;

// Reads the text form: lines of numbers separated by blanks, tabs or commas, every line as many; `#` begins a comment; one line
// "samples_per_pixel NUMBER" before the numbers. Errors begin with "<file_name>:<line>:<column>: ". At most 256 x 256 samples, of any
// parity: the centroid, not the middle sample, is where the point source is.
Result<PsfKernel> ParsePsfKernel(std::string_view text, const std::string& file_name);

// What every kernel must be, text or raster: 1 .. 256 samples a side, samples_per_pixel in 0.5 .. 64, finite values, a positive sum, negative
// samples (noise of the measurement) that add up to at most 5 % of the positive ones, no wider than 20 sensor pixels. `subject` stands
// in front of errors.
Status CheckPsfKernel(const PsfKernel& kernel, const std::string& subject);

// Centroid [samples from the middle of the kernel; x right, y down] of a valid kernel. It is taken out when the kernel is used: a PSF that is off
// centre would move every frame the same way, which is not seen in the frames but is wrong on the ground.
struct KernelCentroid {
  double x = 0.0;
  double y = 0.0;
};
KernelCentroid CentroidOf(const PsfKernel& kernel);

// Value at (x, y) [samples from the centroid] by Keys' cubic, 0 outside, not below 0.
double SampleKernel(const PsfKernel& kernel, const KernelCentroid& centroid, double x, double y);

}  // namespace trem
