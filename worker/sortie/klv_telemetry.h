#pragma once

#include <map>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/telemetry/klv_stream.h"

namespace trem {

// The KLV of a video's data streams.
struct KlvTelemetry {
  std::map<int, KlvStreamContent> streams;  // By stream index: those with any packet.
  int chosen = -1;                          // The stream with the most usable records, of equals the first; -1: none has any.
  double time_base_s = 0.0;                 // Of the video.
  std::vector<v1::Note> notes;              // What the streams hold, and what is wrong with it.
};

Result<KlvTelemetry> ReadKlvTelemetry(const std::string& path);

}  // namespace trem
