#include "tests/unit/worker/sortie/test_video.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mosaic/base/rng.h"
#include "worker/sortie/av_handles.h"

extern "C" {
#include <libavutil/opt.h>
#include <libavutil/pixdesc.h>
}

namespace trem::testing {
namespace {

void WritePackets(AVCodecContext* encoder, AVFormatContext* output, const AVFrame* frame) {
  ASSERT_GE(avcodec_send_frame(encoder, frame), 0);
  const AvPacketPtr packet(av_packet_alloc());
  while (avcodec_receive_packet(encoder, packet.get()) == 0) {
    if (packet->duration == 0) packet->duration = 1;
    av_packet_rescale_ts(packet.get(), encoder->time_base, output->streams[0]->time_base);
    packet->stream_index = 0;
    ASSERT_GE(av_interleaved_write_frame(output, packet.get()), 0);
  }
}

void FillFrame(const Image<float>& pixels, const TestVideo& options, AVFrame* frame) {
  ASSERT_GE(av_frame_make_writable(frame), 0);
  for (int y = 0; y < pixels.height(); ++y) {
    for (int x = 0; x < pixels.width(); ++x) {
      frame->data[0][y * frame->linesize[0] + x] = static_cast<std::uint8_t>(std::clamp(pixels.at(x, y) + 0.5F, 0.0F, 255.0F));
    }
  }
  for (int plane = 1; plane < 3 && frame->data[plane] != nullptr; ++plane) {
    std::fill_n(frame->data[plane], frame->linesize[plane] * pixels.height() / 2, std::uint8_t{128});
  }
  frame->interlaced_frame = options.interlaced ? 1 : 0;
  frame->top_field_first = options.interlaced ? 1 : 0;
}

}  // namespace

bool HasEncoder(const std::string& name) { return avcodec_find_encoder_by_name(name.c_str()) != nullptr; }

void WriteVideo(const std::filesystem::path& path, const std::vector<Image<float>>& frames, const TestVideo& options) {
  av_log_set_level(AV_LOG_QUIET);
  const AVCodec* codec = avcodec_find_encoder_by_name(options.encoder.c_str());
  ASSERT_NE(codec, nullptr) << "no encoder " << options.encoder;
  AvCodecPtr encoder(avcodec_alloc_context3(codec));
  encoder->width = frames.at(0).width();
  encoder->height = frames.at(0).height();
  encoder->pix_fmt = av_get_pix_fmt(options.pixel_format.c_str());
  encoder->time_base = {1, options.frame_rate_hz};
  encoder->framerate = {options.frame_rate_hz, 1};
  encoder->gop_size = options.gop_frames;
  encoder->max_b_frames = options.b_frames;
  encoder->thread_count = 1;
  encoder->bit_rate = 2'000'000;
  encoder->flags |= AV_CODEC_FLAG_BITEXACT;
  encoder->color_range = options.full_range ? AVCOL_RANGE_JPEG : AVCOL_RANGE_UNSPECIFIED;
  if (options.interlaced) {
    encoder->flags |= AV_CODEC_FLAG_INTERLACED_DCT | AV_CODEC_FLAG_INTERLACED_ME;
    encoder->field_order = AV_FIELD_TT;
  }
  AVFormatContext* output = nullptr;
  ASSERT_GE(avformat_alloc_output_context2(&output, nullptr, nullptr, path.c_str()), 0);
  if ((output->oformat->flags & AVFMT_GLOBALHEADER) != 0) encoder->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  ASSERT_GE(avcodec_open2(encoder.get(), codec, nullptr), 0);
  AVStream* stream = avformat_new_stream(output, nullptr);
  stream->time_base = encoder->time_base;
  stream->avg_frame_rate = encoder->framerate;
  ASSERT_GE(avcodec_parameters_from_context(stream->codecpar, encoder.get()), 0);
  ASSERT_GE(avio_open(&output->pb, path.c_str(), AVIO_FLAG_WRITE), 0);
  ASSERT_GE(avformat_write_header(output, nullptr), 0);
  const AvFramePtr frame(av_frame_alloc());
  frame->format = encoder->pix_fmt;
  frame->width = encoder->width;
  frame->height = encoder->height;
  ASSERT_GE(av_frame_get_buffer(frame.get(), 0), 0);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    FillFrame(frames[i], options, frame.get());
    frame->pts = static_cast<std::int64_t>(i);
    WritePackets(encoder.get(), output, frame.get());
  }
  WritePackets(encoder.get(), output, nullptr);
  ASSERT_GE(av_write_trailer(output), 0);
  avio_closep(&output->pb);
  avformat_free_context(output);
}

Image<float> TexturedFrame(int width, int height, double x, double y, std::uint64_t seed) {
  Image<float> frame(width, height);
  Rng rng({seed, 17});
  constexpr int kWaves = 40;
  double amplitude[kWaves], fx[kWaves], fy[kWaves], phase[kWaves];
  for (int i = 0; i < kWaves; ++i) {
    const double period_px = 6.0 * std::pow(12.0, rng.Uniform());
    const double angle = 2.0 * M_PI * rng.Uniform();
    amplitude[i] = 4.0 * std::sqrt(period_px / 10.0);
    fx[i] = 2.0 * M_PI * std::cos(angle) / period_px;
    fy[i] = 2.0 * M_PI * std::sin(angle) / period_px;
    phase[i] = 2.0 * M_PI * rng.Uniform();
  }
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      double value = 128.0;
      for (int i = 0; i < kWaves; ++i) value += amplitude[i] * std::sin(fx[i] * (u + x) + fy[i] * (v + y) + phase[i]);
      frame.at(u, v) = static_cast<float>(std::clamp(value, 20.0, 235.0));
    }
  }
  return frame;
}

}  // namespace trem::testing
