#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/sortie/grey_image.h"
#include "worker/sortie/video_stream.h"

namespace trem {

struct VideoReaderOptions {
  bool deinterlace = false;
  // Never seek: count frames from the start of the file. For streams whose time stamps or damage make seeking inexact; the first read of
  // a late frame then costs a decode of all before it.
  bool from_start = false;
  // Frames ahead of the last one that are reached by decoding on rather than by a seek, and frames from the start of the file that are
  // reached from there. Larger is slower on jumps, never wrong.
  int forward_frames_max = 128;
};

// One frame of a video: its number in the file, counted from 0, and its presentation time stamp.
struct VideoFrameId {
  std::int64_t number = 0;
  std::int64_t pts = 0;
};

// Random access to the frames of a video with the same pixels whatever was read before: after a seek, decoding starts at least two key
// frames before the wanted one (so that frames which refer across a key frame, and the deinterlacer's neighbours, are as in a decode
// from the start), and the frame is recognised by its pts. Where that fails, it counts from the start of the file.
class VideoReader {
 public:
  // `frames` as found by a decode from the start, in ascending order. Same errors as VideoStream::Open.
  static Result<std::unique_ptr<VideoReader>> Open(const std::string& path, std::vector<VideoFrameId> frames, VideoReaderOptions options);

  // `index` into `frames`. kCorrupt when the file no longer holds that frame; errors name file and frame.
  Result<GreyImage> Read(int index);

  // How often a read had to begin at the start of the file, for tests and statistics.
  int restart_count() const { return restart_count_; }

 private:
  VideoReader(std::string path, std::vector<VideoFrameId> frames, VideoReaderOptions options)
      : path_(std::move(path)), frames_(std::move(frames)), options_(options) {}
  Status Restart();
  // Both leave the wanted frame in *frame; null: not found that way.
  Result<AvFramePtr> ReadBySeeking(const VideoFrameId& wanted);
  Result<AvFramePtr> ReadByCounting(const VideoFrameId& wanted);
  Result<AvFramePtr> ReadOnwards(const VideoFrameId& wanted);

  std::string path_;
  std::vector<VideoFrameId> frames_;
  VideoReaderOptions options_;
  std::unique_ptr<VideoStream> stream_;
  // Number of the frame that stream_ gives next; -1: unknown, the stream has to be placed again.
  std::int64_t next_number_ = -1;
  int restart_count_ = 0;
};

}  // namespace trem
