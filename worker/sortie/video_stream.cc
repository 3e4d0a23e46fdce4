#include "worker/sortie/video_stream.h"

#include <algorithm>
#include <filesystem>
#include <mutex>

#include "worker/sortie/grey_image.h"

namespace trem {
namespace {

// More errors than any decoder can hold frames: it will not come to an end.
constexpr int kDrainErrorsMax = 64;

// What libav has to say reaches the user by way of our own messages.
void QuietLibav() {
  static std::once_flag once;
  std::call_once(once, [] { av_log_set_level(AV_LOG_QUIET); });
}

Status NotAVideo(const std::string& path, const std::string& found) {
  return InvalidInput(path + ": not a video that can be decoded (" + found + "); expected a file that FFmpeg reads, with a video stream");
}

}  // namespace

Result<std::unique_ptr<VideoStream>> VideoStream::Open(const std::string& path, bool deinterlace) {
  QuietLibav();
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return NotFound(path + ": no such file");
  std::unique_ptr<VideoStream> stream(new VideoStream(path, deinterlace));
  TREM_RETURN_IF_ERROR(stream->OpenInput());
  stream->ReadFacts();
  TREM_RETURN_IF_ERROR(stream->OpenDecoder());
  return stream;
}

Status VideoStream::OpenInput() {
  AVFormatContext* context = nullptr;
  const int error = OpenContainer(path_, &context);
  if (error < 0) return NotAVideo(path_, AvErrorText(error));
  input_.reset(context);
  const int info_error = avformat_find_stream_info(input_.get(), nullptr);
  if (info_error < 0) return NotAVideo(path_, AvErrorText(info_error));
  for (unsigned i = 0; i < input_->nb_streams && stream_index_ < 0; ++i) {
    const AVStream& stream = *input_->streams[i];
    if (stream.codecpar->codec_type == AVMEDIA_TYPE_VIDEO && (stream.disposition & AV_DISPOSITION_ATTACHED_PIC) == 0) {
      stream_index_ = static_cast<int>(i);
    }
  }
  if (stream_index_ < 0) return NotAVideo(path_, "there is no video stream among its " + std::to_string(input_->nb_streams) + " streams");
  for (unsigned i = 0; i < input_->nb_streams; ++i) {
    input_->streams[i]->discard = static_cast<int>(i) == stream_index_ ? AVDISCARD_DEFAULT : AVDISCARD_ALL;
  }
  return {};
}

void VideoStream::ReadFacts() {
  const AVStream& stream = *input_->streams[stream_index_];
  const AVCodecParameters& parameters = *stream.codecpar;
  facts_.container = input_->iformat->name;
  facts_.codec = avcodec_get_name(parameters.codec_id);
  facts_.width_px = parameters.width;
  facts_.height_px = parameters.height;
  facts_.time_base_s = av_q2d(stream.time_base);
  facts_.frame_rate_hz = stream.avg_frame_rate.den > 0 ? av_q2d(stream.avg_frame_rate) : 0.0;
  facts_.frame_count = stream.nb_frames;
  const AVRational aspect = stream.sample_aspect_ratio.num > 0 ? stream.sample_aspect_ratio : parameters.sample_aspect_ratio;
  facts_.sample_aspect_ratio = aspect.num > 0 && aspect.den > 0 ? av_q2d(aspect) : 1.0;
  facts_.interlaced = parameters.field_order == AV_FIELD_TT || parameters.field_order == AV_FIELD_BB ||
                      parameters.field_order == AV_FIELD_TB || parameters.field_order == AV_FIELD_BT;
}

Status VideoStream::OpenDecoder() {
  const AVStream& stream = *input_->streams[stream_index_];
  const AVCodec* codec = avcodec_find_decoder(stream.codecpar->codec_id);
  if (codec == nullptr) return NotAVideo(path_, "no decoder for " + facts_.codec);
  decoder_.reset(avcodec_alloc_context3(codec));
  TREM_CHECK(decoder_ != nullptr);
  int error = avcodec_parameters_to_context(decoder_.get(), stream.codecpar);
  if (error < 0) return NotAVideo(path_, AvErrorText(error));
  decoder_->pkt_timebase = stream.time_base;
  decoder_->thread_count = 1;
  decoder_->flags |= AV_CODEC_FLAG_BITEXACT;
  decoder_->max_pixels = kImageAreaMax_px;
  error = avcodec_open2(decoder_.get(), codec, nullptr);
  if (error < 0) return NotAVideo(path_, facts_.codec + ": " + AvErrorText(error));
  deinterlacer_ = deinterlace_ ? std::make_unique<Deinterlacer>(stream.time_base) : nullptr;
  draining_ = at_end_ = false;
  frames_out_ = 0;
  key_pts_[0] = key_pts_[1] = AV_NOPTS_VALUE;
  return {};
}

bool VideoStream::SeekBefore(std::int64_t pts) {
  if (av_seek_frame(input_.get(), stream_index_, pts, AVSEEK_FLAG_BACKWARD) < 0) return false;
  wait_for_key_ = true;
  return OpenDecoder().ok();
}

void VideoStream::NoteKey(const AVPacket& packet) {
  if ((packet.flags & AV_PKT_FLAG_KEY) == 0) return;
  const std::int64_t pts = packet.pts != AV_NOPTS_VALUE ? packet.pts : packet.dts;
  if (pts == AV_NOPTS_VALUE) return;
  if (key_pts_[0] == AV_NOPTS_VALUE) {
    key_pts_[0] = pts;
  } else if (key_pts_[1] == AV_NOPTS_VALUE) {
    key_pts_[1] = pts;
  }
}

int VideoStream::KeysUpTo(std::int64_t pts) const {
  return static_cast<int>(
      std::count_if(std::begin(key_pts_), std::end(key_pts_), [pts](std::int64_t key) { return key != AV_NOPTS_VALUE && key <= pts; }));
}

void VideoStream::SendPacket(const AVPacket* packet) {
  const int error = avcodec_send_packet(decoder_.get(), packet);
  if (error < 0 && error != AVERROR(EAGAIN) && error != AVERROR_EOF) ++damaged_packets_;
}

AvFramePtr VideoStream::Decode() {
  const AvPacketPtr packet(av_packet_alloc());
  AvFramePtr frame(av_frame_alloc());
  TREM_CHECK(packet != nullptr && frame != nullptr);
  int drain_errors = 0;
  while (true) {
    const int error = avcodec_receive_frame(decoder_.get(), frame.get());
    if (error == 0) return frame;
    if (error == AVERROR_EOF || (draining_ && error == AVERROR(EAGAIN))) return nullptr;
    if (error != AVERROR(EAGAIN)) {
      ++damaged_packets_;
      if (draining_ && ++drain_errors > kDrainErrorsMax) return nullptr;
      if (draining_) continue;
    }
    const int read_error = av_read_frame(input_.get(), packet.get());
    if (read_error < 0) {
      if (read_error != AVERROR_EOF) read_error_ = AvErrorText(read_error);
      SendPacket(nullptr);
      draining_ = true;
      continue;
    }
    if (packet->stream_index == stream_index_) {
      NoteKey(*packet);
      if ((packet->flags & AV_PKT_FLAG_KEY) != 0) wait_for_key_ = false;
      if (!wait_for_key_) SendPacket(packet.get());
    }
    av_packet_unref(packet.get());
  }
}

Result<AvFramePtr> VideoStream::Next() {
  while (true) {
    AvFramePtr frame;
    if (deinterlacer_ == nullptr) {
      if (!at_end_) frame = Decode();
      at_end_ = frame == nullptr;
    } else {
      frame = deinterlacer_->Pop();
      if (frame == nullptr && !at_end_) {
        const AvFramePtr decoded = Decode();
        at_end_ = decoded == nullptr;
        TREM_RETURN_IF_ERROR((at_end_ ? deinterlacer_->Flush() : deinterlacer_->Push(*decoded)).WithPrefix(path_));
        continue;
      }
    }
    if (frame != nullptr) ++frames_out_;
    return frame;
  }
}

}  // namespace trem
