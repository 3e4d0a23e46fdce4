#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>

#include "mosaic/base/status.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/planar_map.h"

namespace trem {

// How a frame fitted into the scene of one segment of a window.
struct ChainFit {
  std::uint32_t segment_id = 0;
  PlanarMap scene_from_sensor;  // Cells from sensor pixels.
  double gain = 1.0;         // frame = gain * scene + offset, internal grey levels.
  double offset = 0.0;
  double residual_rms = 0.0;  // Internal grey levels.
  double correlation = 0.0;
  double overlap = 0.0;  // Part of the ROI's pixels with seen scene behind them.
};

// One line of mosaic_chain.csv: a frame in a window; without a window, a frame that no window took.
struct ChainRow {
  std::uint32_t frame_index = 0;
  std::string frame_name;
  double time_s = 0.0;
  std::optional<std::uint32_t> window_id;
  std::string status;  // registered, started_scene, skipped, lost, not_used.
  std::string reason;
  std::optional<ChainFit> fit;
  std::optional<Homography> world_from_sensor;  // When the frame is aligned: mosaic CRS from sensor pixels.
};

// `text` as one CSV field (RFC 4180): in quotes when it has to be.
std::string CsvField(const std::string& text);

// Writes mosaic_chain.csv row by row (RFC 4180, lines end in \n; numbers in the shortest form that reads back as the same double;
// absent values are empty). Streams to `path`, which callers publish.
class ChainCsvWriter {
 public:
  static Result<ChainCsvWriter> Create(const std::filesystem::path& path);
  Status Write(const ChainRow& row);
  // Flushes; kExhausted when the disk is full. Call once, at the end.
  Status Close();

 private:
  ChainCsvWriter(std::filesystem::path path, std::ofstream stream) : path_(std::move(path)), stream_(std::move(stream)) {}
  std::filesystem::path path_;
  std::ofstream stream_;
};

}  // namespace trem
