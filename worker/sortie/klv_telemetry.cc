#include "worker/sortie/klv_telemetry.h"

#include <fmt/format.h>

#include <memory>

#include "worker/sortie/data_packets.h"
#include "worker/sortie/frame_source.h"

namespace trem {
namespace {

std::string SetsText(const KlvStreamContent& content) {
  std::string text;
  if (content.st0601 > 0) text += fmt::format("{} ST 0601 local sets", content.st0601);
  if (content.eg0104 > 0) text += fmt::format("{}{} EG 0104 universal sets", text.empty() ? "" : ", ", content.eg0104);
  if (content.other_keys > 0) text += fmt::format("{}{} packets with other keys", text.empty() ? "" : ", ", content.other_keys);
  return text.empty() ? "no KLV" : text;
}

void NoteContent(const std::string& path, int index, const KlvStreamContent& content, bool chosen, std::vector<v1::Note>* notes) {
  const std::string stream = "data stream " + std::to_string(index);
  const auto add = [&](v1::Severity severity, const char* code, const std::string& text) {
    notes->push_back(MakeNote(severity, code, path, stream + ": " + text));
  };
  std::string text = SetsText(content) + fmt::format(", {} of them with a pose or corners", content.usable());
  if (!content.sensor_name.empty()) text += ", sensor \"" + content.sensor_name + "\"";
  if (chosen) text += "; the one that is looked at; time from " + content.clock;
  if (!chosen) text += "; not used";
  add(v1::INFO, "klv_stream", text);
  if (content.bad_checksums > 0) {
    add(v1::WARNING, "klv_bad_checksum",
        fmt::format("{} packets have a wrong checksum and are not used; the first, {}", content.bad_checksums, content.first_bad_checksum));
  }
  if (content.without_checksum > 0) {
    add(v1::INFO, "klv_without_checksum", fmt::format("{} ST 0601 sets bring no checksum", content.without_checksum));
  }
  if (content.impossible + content.cut_short + content.ill_formed > 0) {
    add(v1::WARNING, "klv_damaged",
        fmt::format(
            "{} packets with impossible lengths and {} cut short are not used, nor are {} items of a wrong length or out of range; the "
            "first: {}",
            content.impossible, content.cut_short, content.ill_formed, content.first_problem));
  }
  if (content.error_values > 0) {
    add(v1::INFO, "klv_error_values", fmt::format("{} items say that they are out of range or in error: absent", content.error_values));
  }
  if (content.limit_reached) {
    add(v1::WARNING, "klv_too_long", fmt::format("only the first {} sets are used; split the sortie", kTelemetryRecordsMax));
  }
}

}  // namespace

Result<KlvTelemetry> ReadKlvTelemetry(const std::string& path) {
  std::map<int, std::unique_ptr<KlvStreamReader>> readers;
  const auto consume = [&readers](int index, std::optional<double> pts_s, Bytes bytes) {
    std::unique_ptr<KlvStreamReader>& reader = readers[index];
    if (reader == nullptr) reader = std::make_unique<KlvStreamReader>();
    reader->Feed(bytes, pts_s);
  };
  TREM_ASSIGN_OR_RETURN(const DataStreams streams, ReadDataPackets(path, consume));
  KlvTelemetry telemetry;
  telemetry.time_base_s = streams.video_time_base_s;
  int most = 0;
  for (const auto& [index, reader] : readers) {
    const KlvStreamContent& content = telemetry.streams[index] = reader->Finish();
    if (content.usable() <= most) continue;
    most = content.usable();
    telemetry.chosen = index;
  }
  for (const DataStreamFacts& facts : streams.streams) {
    const auto content = telemetry.streams.find(facts.index);
    if (content != telemetry.streams.end()) {
      NoteContent(path, facts.index, content->second, facts.index == telemetry.chosen, &telemetry.notes);
    } else {
      telemetry.notes.push_back(
          MakeNote(v1::INFO, "klv_stream", path, "data stream " + std::to_string(facts.index) + ": is announced and empty"));
    }
  }
  return telemetry;
}

}  // namespace trem
