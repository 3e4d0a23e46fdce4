#include "worker/sortie/frame_source.h"

#include <algorithm>
#include <filesystem>
#include <map>

#include "worker/sortie/image_sequence_reader.h"
#include "worker/sortie/luma.h"
#include "worker/sortie/utf8.h"
#include "worker/sortie/video_stream.h"

namespace trem {
namespace {

constexpr double kFrameRateDefault_hz = 25.0;
constexpr int kTransportPacket_bytes = 188;

double FrameRate(const v1::Source& source) { return source.frame_rate_hz() > 0.0 ? source.frame_rate_hz() : kFrameRateDefault_hz; }

Status FirstFrameProblem(const v1::Source& source, std::int64_t count) {
  return InvalidInput(source.path() + ": source.first_frame is " + std::to_string(source.first_frame()) + ", but there are " +
                      std::to_string(count) + " frames; expected 0.." + std::to_string(std::max<std::int64_t>(count - 1, 0)));
}

class ImageSource final : public FrameSource {
 public:
  static Result<std::unique_ptr<FrameSource>> Open(const v1::Source& source) {
    TREM_ASSIGN_OR_RETURN(ImageList list, ListImages(source.path()));
    std::unique_ptr<ImageSource> images(new ImageSource(source));
    images->list_ = std::move(list);
    const auto count = static_cast<std::int64_t>(images->list_.names.size());
    for (const std::string& name : images->list_.names) {
      if (!IsValidUtf8(name)) return InvalidInput(source.path() + ": the file name '" + ToValidUtf8(name) + "' is not UTF-8; rename it");
    }
    if (source.first_frame() >= count) return FirstFrameProblem(source, count);
    images->next_ = source.first_frame();
    images->end_ = source.max_frames() == 0 ? count : std::min<std::int64_t>(count, images->next_ + source.max_frames());
    TREM_RETURN_IF_ERROR(images->FindMajoritySize());
    return std::unique_ptr<FrameSource>(std::move(images));
  }

  Result<bool> Next(SourceFrame* frame) override {
    if (next_ >= end_) return false;
    frame->number = next_++;
    frame->name = list_.names[static_cast<std::size_t>(frame->number)];
    const std::filesystem::path path = list_.folder / frame->name;
    frame->path = path.string();
    frame->pts = 0;
    frame->time_s = static_cast<double>(frame->number) / FrameRate(source_);
    frame->read = [path] { return ReadGreyImage(path); };
    return true;
  }
  std::int64_t expected_count() const override { return end_ - source_.first_frame(); }
  int width_px() const override { return size_.width_px; }
  int height_px() const override { return size_.height_px; }
  v1::SourceKind kind() const override { return v1::IMAGE_SEQUENCE; }

 private:
  explicit ImageSource(const v1::Source& source) : source_(source) {}

  // The size that most images state in their headers; of equals, the one that comes first.
  Status FindMajoritySize() {
    std::map<std::pair<int, int>, std::int64_t> counts;
    std::vector<ImageSize> sizes;
    Status first_problem;
    for (std::int64_t i = next_; i < end_; ++i) {
      const Result<ImageSize> size = ReadImageSize(list_.folder / list_.names[static_cast<std::size_t>(i)]);
      if (size.ok()) {
        sizes.push_back(*size);
        ++counts[{size->width_px, size->height_px}];
      } else if (first_problem.ok()) {
        first_problem = Status(size.status().code(), "frame " + std::to_string(i - next_) + ", " + size.status().message());
      }
    }
    if (sizes.empty()) {
      return InvalidInput(source_.path() + ": none of its " + std::to_string(end_ - next_) +
                          " images can be read; the first: " + first_problem.message());
    }
    std::int64_t most = 0;
    for (const ImageSize& size : sizes) {
      const std::int64_t count = counts[{size.width_px, size.height_px}];
      if (count <= most) continue;
      most = count;
      size_ = size;
    }
    return {};
  }

  v1::Source source_;
  ImageList list_;
  ImageSize size_;
  std::int64_t next_ = 0;
  std::int64_t end_ = 0;
};

class VideoSource final : public FrameSource {
 public:
  static Result<std::unique_ptr<FrameSource>> Open(const v1::Source& source) {
    std::unique_ptr<VideoSource> video(new VideoSource(source));
    video->deinterlaced_ = source.deinterlace() == v1::DEINTERLACE_ALWAYS;
    if (source.deinterlace() == v1::DEINTERLACE_AUTO) {
      TREM_ASSIGN_OR_RETURN(video->deinterlaced_, IsInterlaced(source.path()));
    }
    TREM_ASSIGN_OR_RETURN(video->stream_, VideoStream::Open(source.path(), video->deinterlaced_));
    return std::unique_ptr<FrameSource>(std::move(video));
  }

  Result<bool> Next(SourceFrame* frame) override {
    while (source_.max_frames() == 0 || given_ < source_.max_frames()) {
      TREM_ASSIGN_OR_RETURN(const std::shared_ptr<const AVFrame> decoded, stream_->Next());
      if (decoded == nullptr) {
        reached_end_ = true;
        if (number_ > source_.first_frame()) return false;
        if (number_ == 0) return NoFrame();
        return FirstFrameProblem(source_, number_);
      }
      const std::int64_t number = number_++;
      SetTime(*decoded, number);
      if ((decoded->flags & AV_FRAME_FLAG_CORRUPT) != 0 || decoded->decode_error_flags != 0) ++damaged_frames_;
      if (number < source_.first_frame()) continue;
      ++given_;
      frame->number = number;
      frame->name = "#" + std::to_string(number);
      frame->path = source_.path();
      frame->pts = pts_;
      frame->time_s = time_s_;
      frame->read = [decoded] { return GreyFromVideoFrame(*decoded); };
      return true;
    }
    return false;
  }
  std::int64_t expected_count() const override {
    const std::int64_t all =
        stream_->facts().frame_count == 0 ? 0 : std::max<std::int64_t>(0, stream_->facts().frame_count - source_.first_frame());
    if (source_.max_frames() == 0) return all;
    return all == 0 ? source_.max_frames() : std::min<std::int64_t>(all, source_.max_frames());
  }
  int width_px() const override { return stream_->facts().width_px; }
  int height_px() const override { return stream_->facts().height_px; }
  v1::SourceKind kind() const override { return v1::VIDEO; }
  bool deinterlaced() const override { return deinterlaced_; }

  std::vector<v1::Note> notes() const override {
    std::vector<v1::Note> notes;
    const VideoFacts& facts = stream_->facts();
    if (deinterlaced_) {
      notes.push_back(MakeNote(v1::INFO, "deinterlaced", source_.path(), "the video is interlaced: every frame was deinterlaced"));
    }
    if (std::abs(facts.sample_aspect_ratio - 1.0) > 0.01) {
      notes.push_back(MakeNote(v1::WARNING, "pixels_not_square", source_.path(),
                               "the video's pixels are " + std::to_string(facts.sample_aspect_ratio) +
                                   " times as wide as high; the sensor model expects square ones"));
    }
    AddDamage(&notes);
    return notes;
  }

 private:
  explicit VideoSource(const v1::Source& source) : source_(source) {}

  // What most of the first frames say.
  static Result<bool> IsInterlaced(const std::string& path) {
    TREM_ASSIGN_OR_RETURN(const std::unique_ptr<VideoStream> stream, VideoStream::Open(path, false));
    int interlaced = 0;
    int frames = 0;
    for (; frames < 8; ++frames) {
      TREM_ASSIGN_OR_RETURN(const AvFramePtr frame, stream->Next());
      if (frame == nullptr) break;
      interlaced += frame->interlaced_frame != 0 ? 1 : 0;
    }
    return 2 * interlaced > frames;
  }

  Status NoFrame() const {
    return InvalidInput(source_.path() + ": no frame could be decoded (" + stream_->facts().codec + ", " +
                        std::to_string(stream_->damaged_packets()) + " damaged packets); the file is damaged or cut short");
  }

  // Frames without a time stamp continue at the container's rate.
  void SetTime(const AVFrame& frame, std::int64_t number) {
    const VideoFacts& facts = stream_->facts();
    const double interval_s = 1.0 / (facts.frame_rate_hz > 0.0 ? facts.frame_rate_hz : FrameRate(source_));
    pts_ = frame.best_effort_timestamp;
    if (pts_ != AV_NOPTS_VALUE) {
      if (number == 0) first_pts_ = pts_;
      time_s_ = static_cast<double>(pts_ - first_pts_) * facts.time_base_s;
    } else {
      if (number == 0) first_pts_ = 0;
      time_s_ = number == 0 ? 0.0 : time_s_ + interval_s;
      pts_ = 0;
    }
  }

  void AddDamage(std::vector<v1::Note>* notes) const {
    const std::string decoded = std::to_string(number_) + " frames were decoded, up to " + std::to_string(time_s_) + " s";
    const std::int64_t announced = stream_->facts().frame_count;
    std::error_code error;
    const auto bytes = std::filesystem::file_size(source_.path(), error);
    const bool partial_packet = stream_->facts().container == "mpegts" && !error && bytes % kTransportPacket_bytes != 0;
    if (reached_end_ && (announced > number_ + 1 || !stream_->read_error().empty() || partial_packet)) {
      notes->push_back(MakeNote(
          v1::WARNING, "video_cut_short", source_.path(),
          "the file ends early: " + decoded + (announced > 0 ? "; its header announces " + std::to_string(announced) + " frames" : "")));
    }
    if (stream_->damaged_packets() > 0 || damaged_frames_ > 0) {
      notes->push_back(MakeNote(v1::WARNING, "video_damaged", source_.path(),
                                std::to_string(stream_->damaged_packets()) + " packets could not be decoded and " +
                                    std::to_string(damaged_frames_) + " frames were patched up by the decoder; " + decoded));
    }
  }

  v1::Source source_;
  bool deinterlaced_ = false;
  std::unique_ptr<VideoStream> stream_;
  std::int64_t number_ = 0;  // Frames decoded.
  std::int64_t given_ = 0;
  std::int64_t first_pts_ = 0;
  std::int64_t pts_ = 0;
  double time_s_ = 0.0;
  int damaged_frames_ = 0;
  bool reached_end_ = false;
};

}  // namespace

Result<std::unique_ptr<FrameSource>> OpenFrameSource(const v1::Sortie& sortie) {
  const std::string& path = sortie.source().path();
  if (path.empty()) return InvalidInput("source.path is empty; expected a video file, a folder of images or a glob");
  std::error_code error;
  const bool is_file = std::filesystem::is_regular_file(path, error);
  if (is_file && !HasImageExtension(path)) return VideoSource::Open(sortie.source());
  return ImageSource::Open(sortie.source());
}

v1::Note MakeNote(v1::Severity severity, const std::string& code, const std::string& subject, const std::string& message) {
  v1::Note note;
  note.set_severity(severity);
  note.set_code(code);
  note.set_subject(ToValidUtf8(subject));
  note.set_message(ToValidUtf8(message));
  return note;
}

}  // namespace trem
