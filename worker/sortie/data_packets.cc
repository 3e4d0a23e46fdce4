#include "worker/sortie/data_packets.h"

#include <algorithm>
#include <filesystem>

#include "worker/sortie/av_handles.h"

namespace trem {

Result<DataStreams> ReadDataPackets(
    const std::string& path,
    const std::function<void(int stream_index, std::optional<double> pts_s, std::span<const std::uint8_t> bytes)>& consume) {
  std::error_code error_code;
  if (!std::filesystem::exists(path, error_code)) return NotFound(path + ": no such file");
  AVFormatContext* context = nullptr;
  int error = OpenContainer(path, &context);
  if (error < 0) return InvalidInput(path + ": not a container that can be read (" + AvErrorText(error) + ")");
  const AvInputPtr input(context);
  error = avformat_find_stream_info(input.get(), nullptr);
  if (error < 0) return InvalidInput(path + ": not a container that can be read (" + AvErrorText(error) + ")");
  DataStreams result;
  const auto facts_of = [&result](int index) {
    return std::find_if(result.streams.begin(), result.streams.end(),
                        [index](const DataStreamFacts& facts) { return facts.index == index; });
  };
  // Streams may appear while reading; what is no data is dropped by the demuxer.
  const auto note_streams = [&] {
    for (unsigned i = 0; i < input->nb_streams; ++i) {
      AVStream& stream = *input->streams[i];
      const AVMediaType type = stream.codecpar->codec_type;
      if (type == AVMEDIA_TYPE_VIDEO && result.video_time_base_s == 0.0) result.video_time_base_s = av_q2d(stream.time_base);
      if (type != AVMEDIA_TYPE_DATA) {
        stream.discard = AVDISCARD_ALL;
      } else if (facts_of(static_cast<int>(i)) == result.streams.end()) {
        const bool known = stream.codecpar->codec_id != AV_CODEC_ID_NONE;
        result.streams.push_back({static_cast<int>(i), known ? avcodec_get_name(stream.codecpar->codec_id) : "", 0, 0});
      }
    }
  };
  note_streams();
  if (result.streams.empty()) return result;
  const AvPacketPtr packet(av_packet_alloc());
  TREM_CHECK(packet != nullptr);
  while (av_read_frame(input.get(), packet.get()) >= 0) {
    note_streams();
    const auto facts = facts_of(packet->stream_index);
    if (facts != result.streams.end() && packet->size > 0) {
      ++facts->packets;
      facts->bytes += packet->size;
      const std::int64_t pts = packet->pts != AV_NOPTS_VALUE ? packet->pts : packet->dts;
      std::optional<double> pts_s;
      if (pts != AV_NOPTS_VALUE) pts_s = static_cast<double>(pts) * av_q2d(input->streams[packet->stream_index]->time_base);
      consume(packet->stream_index, pts_s, {packet->data, static_cast<std::size_t>(packet->size)});
    }
    av_packet_unref(packet.get());
  }
  return result;
}

}  // namespace trem
