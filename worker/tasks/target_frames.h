#pragma once

#include <map>
#include <optional>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/frame_reader.h"
#include "worker/tasks/pixel_use.h"
#include "worker/tre/target_engine.h"

namespace trem {

// Why a frame of that state cannot be used, to be put behind "the frame ".
const char* UnusableReason(v1::FrameState state);

// The whole-image motion that the manifest holds for a frame, previous_from_current, when it can be believed. kCorrupt when it is not six
// finite numbers.
Result<std::optional<Affine>> BelievedMotion(const v1::ManifestFrame& record);

// Reads whole frames in internal grey levels, masks and weights as PixelUse has them, forwards or backwards. A step back reads a run of frames that ends there, forwards, and
// keeps them (at most kKeptBytesMax): a decoder can only seek to its key frames. One thread at a time.
class TargetFrameReader {
 public:
  static constexpr long long kKeptBytesMax = 256LL << 20;

  // Frames before `frame_begin` are never read. What is lent must outlive the reader.
  TargetFrameReader(const v1::SortieManifest& manifest, int frame_begin, const PixelUse& pixel_use, FrameReader* reader)
      : manifest_(manifest), frame_begin_(frame_begin), pixel_use_(pixel_use), reader_(reader) {}

  Result<TargetFrame> Read(int index);

 private:
  Result<TargetFrame> ReadOne(int index);

  const v1::SortieManifest& manifest_;
  int frame_begin_;
  const PixelUse& pixel_use_;
  FrameReader* reader_;
  int last_ = -1;
  std::map<int, TargetFrame> kept_;
};

}  // namespace trem
