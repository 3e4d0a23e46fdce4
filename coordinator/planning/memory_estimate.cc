#include "coordinator/planning/memory_estimate.h"

namespace trem {
namespace {

constexpr std::uint64_t kMebibyte = 1ULL << 20;
constexpr std::uint64_t kFrameBytesPerPixel = 40;
constexpr std::uint64_t kCellBytes = 60;
constexpr std::uint64_t kHeldBytesPerPixel = 8;
constexpr std::uint64_t kCanvasFactor = 2;
constexpr std::uint64_t kLayersMax = 64;

std::uint64_t RoundUp(std::uint64_t bytes) { return (bytes + kMebibyte - 1) / kMebibyte * kMebibyte; }

}  // namespace

std::uint64_t IngestMemoryBytes() { return RoundUp(kProcessBytes + 4096ULL * 4096ULL * kFrameBytesPerPixel); }

std::uint64_t EnhanceMemoryBytes(const v1::Sortie& sortie, std::uint32_t width_px, std::uint32_t height_px, const WindowPlan& window) {
  const std::uint64_t ratio = sortie.tre().ratio();
  const std::uint64_t cells = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * ratio * ratio;
  const std::uint64_t frame_bytes = static_cast<std::uint64_t>(width_px) * height_px * kFrameBytesPerPixel;
  const std::uint64_t frames = window.frame_end - window.frame_begin;
  const std::uint64_t held_bytes = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * frames * kHeldBytesPerPixel;
  // LANDWEBER keeps the pixels and weights of its window's frames once more.
  const std::uint64_t kept_frames = sortie.tre().update() == v1::LANDWEBER ? sortie.tre().landweber_window() : 0;
  const std::uint64_t kept_bytes = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * 8 * kept_frames;
  return RoundUp(kProcessBytes + cells * kCanvasFactor * kCellBytes + held_bytes + frame_bytes + kept_bytes);
}

std::uint64_t AlignMemoryBytes(const v1::IngestSummary& ingest, std::uint64_t window_bytes_sum) {
  return RoundUp(kProcessBytes + 4 * window_bytes_sum + 4096ULL * ingest.frame_count());
}

std::uint64_t CompositeMemoryBytes(const v1::Sortie& sortie, std::uint64_t window_bytes_sum) {
  const std::uint64_t side_px = sortie.mosaic().tile_px();
  return RoundUp(kProcessBytes + side_px * side_px * (kLayersMax * 12 + 64) + 64 * kMebibyte + 2 * window_bytes_sum);
}

std::uint64_t ExportMemoryBytes(std::uint64_t window_bytes_sum) { return RoundUp(kProcessBytes + 256 * kMebibyte + 4 * window_bytes_sum); }

}  // namespace trem
