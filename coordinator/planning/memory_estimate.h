#pragma once

#include <cstdint>

#include "coordinator/planning/window_plan.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Bounds on the memory a task's process needs, bytes, rounded up to whole MiB. They place tasks on workers with a memory limit and
// tell users what to expect; a worker that needs more reports kExhausted. All contain kProcessBytes for the program, its libraries
// and their caches. w, h: the sensor's image, px.

inline constexpr std::uint64_t kProcessBytes = 192ULL << 20;

// Frames are decoded one after another; colour source, luminance, a pyramid and the previous frame: w h 40 B. The source's size is not
// known yet, so an image of 4096 x 4096 is assumed: the one bound here that a larger sensor can exceed.
std::uint64_t IngestMemoryBytes();

// (roi_w ratio)(roi_h ratio) 2 60 B + roi_w roi_h frames 8 B + w h 40 B. A scene canvas holds at most about twice the ROI's cells, at about 60 B a cell:
// intensity, information, gradient, prior weights, prediction and the raster being written. All frames' pixels and weights of the
// ROI are held. A frame is decoded whole: w h 40 B.
std::uint64_t EnhanceMemoryBytes(const v1::Sortie& sortie, std::uint32_t width_px, std::uint32_t height_px, const WindowPlan& window);

// 4 (sum of window.pb bytes) + 4096 B a frame of the manifest: views, ties and the sparse normal equations.
std::uint64_t AlignMemoryBytes(const v1::IngestSummary& ingest, std::uint64_t window_bytes_sum);

// min(tile_px^2 64 layers 12 B, 256 MiB) + tile_px^2 56 B + min(2 (roi_px ratio)^2, 2^24) cells of the scene being warped 18 B + 2 (sum of
// the bytes of the window.pb that reach the tile). The layers are the scenes that cover one pixel; more of them, and larger tiles, are
// reduced in bands. Does not depend on the size of the mosaic.
std::uint64_t CompositeMemoryBytes(const v1::Sortie& sortie, std::uint64_t window_bytes_sum);

// Tiles pass through one by one; GDAL's block cache and the pictures 256 MiB, the frames that the report compares with w h 48 B, the chain
// and the windows: 4 (sum of window.pb bytes). Does not depend on the size of the mosaic.
std::uint64_t ExportMemoryBytes(const v1::IngestSummary& ingest, std::uint64_t window_bytes_sum);

}  // namespace trem
