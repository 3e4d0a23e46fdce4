#include "coordinator/planning/memory_estimate.h"

#include <algorithm>

namespace trem {
namespace {

constexpr std::uint64_t kMebibyte = 1ULL << 20;
constexpr std::uint64_t kFrameBytesPerPixel = 40;
constexpr std::uint64_t kCellBytes = 120;  // The scene's planes, and once more those of the one that is handed out.
constexpr std::uint64_t kHeldBytesPerPixel = 8;
constexpr std::uint64_t kCanvasFactor = 2;
constexpr std::uint64_t kLayersMax = 64;
// As in mosaic/composite/tile_compositor.h and worker/tasks, which this folder may not include.
constexpr std::uint64_t kStackSampleBytes = 12;
constexpr std::uint64_t kStackBytesMax = 256 * kMebibyte;
constexpr std::uint64_t kSceneCellBytes = 18;
constexpr std::uint64_t kSceneCellsMax = 1ULL << 24;
// Five planes of the tile, the same while they are written, one scene resampled onto all of it.
constexpr std::uint64_t kTilePixelBytes = 20 + 20 + 16;

std::uint64_t RoundUp(std::uint64_t bytes) { return (bytes + kMebibyte - 1) / kMebibyte * kMebibyte; }

}  // namespace

std::uint64_t IngestMemoryBytes() { return RoundUp(kProcessBytes + 4096ULL * 4096ULL * kFrameBytesPerPixel); }

std::uint64_t EnhanceMemoryBytes(const v1::Sortie& sortie, std::uint32_t width_px, std::uint32_t height_px, const WindowPlan& window) {
  const std::uint64_t ratio = sortie.tre().ratio();
  const std::uint64_t cells = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * ratio * ratio;
  const std::uint64_t frame_bytes = static_cast<std::uint64_t>(width_px) * height_px * kFrameBytesPerPixel;
  const std::uint64_t frames = window.frame_end - window.frame_begin;
  const std::uint64_t held_bytes = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * frames * kHeldBytesPerPixel;
  // The schemes keep pixels and weights of frames once more: LANDWEBER its window's, INFORMATION all up to a bound (KeptFrames::kBytesMax).
  std::uint64_t kept_bytes = 0;
  const std::uint64_t frame_kept_bytes = static_cast<std::uint64_t>(window.roi_in_sensor.area()) * 8;
  const v1::UpdateScheme update = sortie.tre().update();
  if (update == v1::LANDWEBER) kept_bytes = frame_kept_bytes * sortie.tre().landweber_window();
  if (update != v1::LANDWEBER && update != v1::POINTWISE)
    kept_bytes = std::min(frame_kept_bytes * frames, 64 * kMebibyte + frame_kept_bytes);
  return RoundUp(kProcessBytes + cells * kCanvasFactor * kCellBytes + held_bytes + frame_bytes + kept_bytes);
}

std::uint64_t AlignMemoryBytes(const v1::IngestSummary& ingest, std::uint64_t window_bytes_sum) {
  return RoundUp(kProcessBytes + 4 * window_bytes_sum + 4096ULL * ingest.frame_count());
}

std::uint64_t CompositeMemoryBytes(const v1::Sortie& sortie, std::uint64_t window_bytes_sum) {
  const std::uint64_t side_px = sortie.mosaic().tile_px(), pixels = side_px * side_px;
  const std::uint64_t stack_bytes = std::min(pixels * kLayersMax * kStackSampleBytes, kStackBytesMax);
  const std::uint64_t roi_cells_side = std::uint64_t{sortie.windows().roi_px()} * sortie.tre().ratio();
  const std::uint64_t scene_cells = std::min(roi_cells_side * roi_cells_side * kCanvasFactor, kSceneCellsMax);
  return RoundUp(kProcessBytes + stack_bytes + pixels * kTilePixelBytes + scene_cells * kSceneCellBytes + 2 * window_bytes_sum);
}

std::uint64_t ExportMemoryBytes(const v1::IngestSummary& ingest, std::uint64_t window_bytes_sum) {
  const std::uint64_t frame_bytes = std::uint64_t{ingest.width_px()} * ingest.height_px() * (kFrameBytesPerPixel + kHeldBytesPerPixel);
  return RoundUp(kProcessBytes + 256 * kMebibyte + frame_bytes + 4 * window_bytes_sum);
}

}  // namespace trem
