#include "worker/sortie/video_reader.h"

#include <algorithm>

#include "worker/sortie/luma.h"

namespace trem {
namespace {

// The deinterlacer's first result after a start lacks its predecessor; two more for good measure.
constexpr int kWarmUpFrames = 3;
// How far before the wanted frame a seek aims, tried in turn.
constexpr int kSeekBack_frames[] = {32, 128, 512, 2048};

}  // namespace

Result<std::unique_ptr<VideoReader>> VideoReader::Open(const std::string& path, std::vector<VideoFrameId> frames,
                                                       VideoReaderOptions options) {
  std::unique_ptr<VideoReader> reader(new VideoReader(path, std::move(frames), options));
  TREM_RETURN_IF_ERROR(reader->Restart());
  return reader;
}

Status VideoReader::Restart() {
  next_number_ = -1;
  TREM_ASSIGN_OR_RETURN(stream_, VideoStream::Open(path_, options_.deinterlace));
  next_number_ = 0;
  ++restart_count_;
  return {};
}

Result<AvFramePtr> VideoReader::ReadOnwards(const VideoFrameId& wanted) {
  while (true) {
    TREM_ASSIGN_OR_RETURN(AvFramePtr frame, stream_->Next());
    if (frame == nullptr) {
      next_number_ = -1;
      return frame;
    }
    if (next_number_++ == wanted.number) return frame;
  }
}

Result<AvFramePtr> VideoReader::ReadByCounting(const VideoFrameId& wanted) {
  TREM_RETURN_IF_ERROR(Restart());
  return ReadOnwards(wanted);
}

Result<AvFramePtr> VideoReader::ReadBySeeking(const VideoFrameId& wanted) {
  const std::int64_t span = frames_.back().pts - frames_.front().pts;
  const std::int64_t interval = std::max<std::int64_t>(1, span / std::max<std::int64_t>(1, static_cast<std::int64_t>(frames_.size()) - 1));
  next_number_ = -1;
  for (const int back : kSeekBack_frames) {
    if (!stream_->SeekBefore(wanted.pts - back * interval)) return AvFramePtr();
    while (true) {
      TREM_ASSIGN_OR_RETURN(AvFramePtr frame, stream_->Next());
      const bool started_too_late = stream_->first_key_pts() != AV_NOPTS_VALUE && stream_->first_key_pts() >= wanted.pts;
      if (frame == nullptr || started_too_late || frame->best_effort_timestamp > wanted.pts) break;
      if (frame->best_effort_timestamp < wanted.pts) continue;
      if (stream_->KeysUpTo(wanted.pts) < 2 || stream_->frames_out() < kWarmUpFrames) break;
      next_number_ = wanted.number + 1;
      return frame;
    }
  }
  return AvFramePtr();
}

Result<GreyImage> VideoReader::Read(int index) {
  TREM_CHECK(index >= 0 && index < static_cast<int>(frames_.size()));
  const VideoFrameId wanted = frames_[static_cast<std::size_t>(index)];
  AvFramePtr frame;
  const bool ahead = next_number_ >= 0 && wanted.number >= next_number_;
  if (ahead && (options_.from_start || wanted.number - next_number_ <= options_.forward_frames_max)) {
    TREM_ASSIGN_OR_RETURN(frame, ReadOnwards(wanted));
  } else if (!options_.from_start && wanted.number > options_.forward_frames_max) {
    TREM_ASSIGN_OR_RETURN(frame, ReadBySeeking(wanted));
  }
  if (frame == nullptr) {
    TREM_ASSIGN_OR_RETURN(frame, ReadByCounting(wanted));
  }
  const std::string subject = path_ + ": frame #" + std::to_string(wanted.number);
  if (frame == nullptr) return Corrupt(subject + " is no longer there; the file has changed since it was ingested");
  Result<GreyImage> image = GreyFromVideoFrame(*frame);
  if (!image.ok()) return image.status().WithPrefix(subject);
  return image;
}

}  // namespace trem
