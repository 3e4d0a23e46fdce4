#pragma once

#include <deque>
#include <memory>

#include "mosaic/base/status.h"
#include "worker/sortie/av_handles.h"

namespace trem {

// One full frame out for every interlaced frame in, in order (libavfilter's bwdif, mode=send_frame). A frame's result depends on its
// two neighbours, so it comes out when the next one went in, or at Flush.
class Deinterlacer {
 public:
  // `time_base` of the frames' pts.
  explicit Deinterlacer(AVRational time_base) : time_base_(time_base) {}

  // Takes the next frame. A frame of another size or format ends the picture sequence and starts a new one.
  Status Push(const AVFrame& frame);
  // No frame follows.
  Status Flush();
  // The next result, with the pts of the frame it belongs to; null when more input is needed.
  AvFramePtr Pop();

 private:
  Status Build(const AVFrame& frame);
  Status Drain();

  AVRational time_base_;
  AvFilterGraphPtr graph_;
  AVFilterContext* source_ = nullptr;
  AVFilterContext* sink_ = nullptr;
  int width_ = 0;
  int height_ = 0;
  int format_ = -1;
  std::deque<std::int64_t> pts_;  // Of the frames whose results have not come out.
  std::deque<AvFramePtr> results_;
};

}  // namespace trem
