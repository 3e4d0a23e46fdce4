#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

struct DataStreamFacts {
  int index = 0;
  std::string codec;  // libavformat's name, "klv" for what says that it is; empty: unknown.
  std::int64_t packets = 0;
  std::int64_t bytes = 0;
};

// The data (not video, audio or subtitle) streams of a file.
struct DataStreams {
  std::vector<DataStreamFacts> streams;
  double video_time_base_s = 0.0;  // Seconds per unit of the first video stream's pts; 0: there is no video.
};

// Hands every packet of every data stream to `consume`, in the file's order: stream index, presentation time in seconds on the container's
// clock (the decoding time where there is none, absent where there is neither) and bytes. Reads the whole file; memory: one packet.
// kNotFound: no such file. kInvalidInput: no container that libavformat reads.
Result<DataStreams> ReadDataPackets(
    const std::string& path,
    const std::function<void(int stream_index, std::optional<double> pts_s, std::span<const std::uint8_t> bytes)>& consume);

}  // namespace trem
