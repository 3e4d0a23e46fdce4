#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "mosaic/base/status.h"
#include "worker/sortie/av_handles.h"
#include "worker/sortie/deinterlacer.h"

namespace trem {

// The facts of a video's first video stream.
struct VideoFacts {
  std::string container;  // libavformat's short name, for example "mpegts".
  std::string codec;
  int width_px = 0;
  int height_px = 0;
  double time_base_s = 0.0;          // Seconds per unit of pts.
  double frame_rate_hz = 0.0;        // As the container states it; 0: unknown.
  double sample_aspect_ratio = 1.0;  // Width of a pixel over its height.
  bool interlaced = false;           // What the stream says.
  std::int64_t frame_count = 0;      // As the container states it; 0: unknown.
};

// Decodes the first video stream of a file forward, in presentation order, with one thread and bit-exact arithmetic. Other streams are
// ignored.
class VideoStream {
 public:
  // kNotFound: no such file. kInvalidInput: not a video, or none that can be decoded; names the file.
  static Result<std::unique_ptr<VideoStream>> Open(const std::string& path, bool deinterlace);

  const VideoFacts& facts() const { return facts_; }

  // Goes to where decoding can start at or before `pts` as well as the container allows, with a fresh decoder: packets before the next
  // key frame are dropped. False when the container cannot seek.
  bool SeekBefore(std::int64_t pts);
  // The next frame; null at the end. Its best_effort_timestamp is its pts. Packets that cannot be decoded are skipped and counted.
  // kFailed when the deinterlacer fails.
  Result<AvFramePtr> Next();

  // Since Open or SeekBefore.
  int frames_out() const { return frames_out_; }
  // Key packets sent to the decoder whose pts is at or before `pts`, at most 2 are told apart.
  int KeysUpTo(std::int64_t pts) const;
  // pts of the first key packet; AV_NOPTS_VALUE before there was one.
  std::int64_t first_key_pts() const { return key_pts_[0]; }
  int damaged_packets() const { return damaged_packets_; }
  // Why reading ended before the container's own end; empty: it did not.
  const std::string& read_error() const { return read_error_; }

 private:
  VideoStream(std::string path, bool deinterlace) : path_(std::move(path)), deinterlace_(deinterlace) {}
  Status OpenInput();
  Status OpenDecoder();
  void ReadFacts();
  // Sends packets until the decoder gives a frame; null at the end.
  AvFramePtr Decode();
  void SendPacket(const AVPacket* packet);
  void NoteKey(const AVPacket& packet);

  std::string path_;
  bool deinterlace_;
  VideoFacts facts_;
  AvInputPtr input_;
  AvCodecPtr decoder_;
  int stream_index_ = -1;
  std::unique_ptr<Deinterlacer> deinterlacer_;
  bool wait_for_key_ = false;
  bool draining_ = false;
  bool at_end_ = false;
  int frames_out_ = 0;
  int damaged_packets_ = 0;
  std::int64_t key_pts_[2] = {AV_NOPTS_VALUE, AV_NOPTS_VALUE};
  std::string read_error_;
};

}  // namespace trem
