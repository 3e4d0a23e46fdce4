// Goal: no bytes that call themselves a PSF kernel crash the reader or what is made of them, and what it accepts keeps its promises.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "worker/sensor/psf_kernel.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto kernel = trem::ParsePsfKernel({reinterpret_cast<const char*>(data), size}, "kernel.txt");
  if (!kernel.ok()) {
    if (!kernel.status().message().starts_with("kernel.txt:")) std::abort();
    return 0;
  }
  if (kernel->values.size() != static_cast<std::size_t>(kernel->width) * static_cast<std::size_t>(kernel->height)) std::abort();
  if (kernel->width > trem::kKernelSideMax || kernel->height > trem::kKernelSideMax) std::abort();
  const trem::KernelCentroid centroid = trem::CentroidOf(*kernel);
  if (!std::isfinite(centroid.x) || !std::isfinite(centroid.y)) std::abort();
  for (int i = -3; i <= 3; ++i) {
    if (!(trem::SampleKernel(*kernel, centroid, i * 0.7, -i * 40.3) >= 0.0)) std::abort();
  }
  return 0;
}
