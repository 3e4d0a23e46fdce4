#include "worker/sortie/deinterlacer.h"

extern "C" {
#include <libavfilter/buffersink.h>
#include <libavfilter/buffersrc.h>
}

#include <string>

namespace trem {

Status Deinterlacer::Build(const AVFrame& frame) {
  graph_.reset(avfilter_graph_alloc());
  TREM_CHECK(graph_ != nullptr);
  graph_->nb_threads = 1;
  const std::string arguments = "video_size=" + std::to_string(frame.width) + "x" + std::to_string(frame.height) +
                                ":pix_fmt=" + std::to_string(frame.format) + ":time_base=" + std::to_string(time_base_.num) + "/" +
                                std::to_string(time_base_.den);
  AVFilterContext* filter = nullptr;
  int error = avfilter_graph_create_filter(&source_, avfilter_get_by_name("buffer"), "in", arguments.c_str(), nullptr, graph_.get());
  if (error >= 0) {
    error = avfilter_graph_create_filter(&filter, avfilter_get_by_name("bwdif"), "deinterlace", "mode=send_frame:parity=auto:deint=all",
                                         nullptr, graph_.get());
  }
  if (error >= 0) error = avfilter_graph_create_filter(&sink_, avfilter_get_by_name("buffersink"), "out", nullptr, nullptr, graph_.get());
  if (error >= 0) error = avfilter_link(source_, 0, filter, 0);
  if (error >= 0) error = avfilter_link(filter, 0, sink_, 0);
  if (error >= 0) error = avfilter_graph_config(graph_.get(), nullptr);
  if (error < 0) {
    graph_.reset();
    return Failed("the deinterlacer cannot be set up for " + std::to_string(frame.width) + " x " + std::to_string(frame.height) +
                  " frames (" + AvErrorText(error) + "); try source.deinterlace=NEVER");
  }
  width_ = frame.width;
  height_ = frame.height;
  format_ = frame.format;
  return {};
}

Status Deinterlacer::Drain() {
  while (true) {
    AvFramePtr result(av_frame_alloc());
    const int error = av_buffersink_get_frame(sink_, result.get());
    if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return {};
    if (error < 0) return Failed("the deinterlacer failed (" + AvErrorText(error) + ")");
    if (pts_.empty()) return Failed("the deinterlacer made more frames than it was given");
    result->pts = pts_.front();
    result->best_effort_timestamp = pts_.front();
    pts_.pop_front();
    results_.push_back(std::move(result));
  }
}

Status Deinterlacer::Push(const AVFrame& frame) {
  if (graph_ != nullptr && (frame.width != width_ || frame.height != height_ || frame.format != format_)) TREM_RETURN_IF_ERROR(Flush());
  if (graph_ == nullptr) TREM_RETURN_IF_ERROR(Build(frame));
  const AvFramePtr copy(av_frame_clone(&frame));
  TREM_CHECK(copy != nullptr);
  pts_.push_back(frame.best_effort_timestamp);
  // The filter interpolates its own pts; ours wait in pts_.
  const int error = av_buffersrc_add_frame(source_, copy.get());
  if (error < 0) return Failed("the deinterlacer refused a frame (" + AvErrorText(error) + ")");
  return Drain();
}

Status Deinterlacer::Flush() {
  if (graph_ == nullptr) return {};
  const int error = av_buffersrc_add_frame(source_, nullptr);
  if (error < 0) return Failed("the deinterlacer cannot be flushed (" + AvErrorText(error) + ")");
  const Status status = Drain();
  graph_.reset();
  pts_.clear();
  return status;
}

AvFramePtr Deinterlacer::Pop() {
  if (results_.empty()) return nullptr;
  AvFramePtr result = std::move(results_.front());
  results_.pop_front();
  return result;
}

}  // namespace trem
