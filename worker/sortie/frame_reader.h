#pragma once

#include <memory>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Reads the pixels of a sortie's frames. One thread at a time.
class FrameReader {
 public:
  virtual ~FrameReader() = default;

  // Frame `index` of the manifest as grey intensities in the SOURCE's grey levels (colour becomes Rec. 601 luminance), width_px x
  // height_px of the manifest. The same pixels whatever was read before; increasing indices are fast (one decode each), a jump costs a
  // seek. Errors name the file and the frame.
  virtual Result<Image<float>> Read(int index) = 0;
};

// `manifest` must outlive the reader.
Result<std::unique_ptr<FrameReader>> OpenFrames(const v1::SortieManifest& manifest);

}  // namespace trem
