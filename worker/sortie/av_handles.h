#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavfilter/avfilter.h>
#include <libavformat/avformat.h>
}

#include <memory>
#include <string>

namespace trem {

// Owners of libav objects, and its error texts.
struct AvDeleter {
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
  void operator()(AVCodecContext* context) const { avcodec_free_context(&context); }
  void operator()(AVFormatContext* context) const { avformat_close_input(&context); }
  void operator()(AVFilterGraph* graph) const { avfilter_graph_free(&graph); }
};
using AvFramePtr = std::unique_ptr<AVFrame, AvDeleter>;
using AvPacketPtr = std::unique_ptr<AVPacket, AvDeleter>;
using AvCodecPtr = std::unique_ptr<AVCodecContext, AvDeleter>;
using AvInputPtr = std::unique_ptr<AVFormatContext, AvDeleter>;
using AvFilterGraphPtr = std::unique_ptr<AVFilterGraph, AvDeleter>;

// Opens the file at `path` as one of the containers that hold video themselves; an error code of libav's otherwise. Playlists (HLS, concat,
// image patterns) are none of them: they would have this process read files that nobody has named.
int OpenContainer(const std::string& path, AVFormatContext** context);

inline std::string AvErrorText(int error) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  av_strerror(error, text, sizeof(text));
  return text;
}

}  // namespace trem
