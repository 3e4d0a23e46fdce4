#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "worker/telemetry/klv_packets.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// Records of one stream at most: more than nine hours at 30 Hz.
inline constexpr std::size_t kTelemetryRecordsMax = 1'000'000;

// What one data stream holds.
struct KlvStreamContent {
  std::vector<TelemetryRecord> records;  // In the order of time_s, one for each moment.
  std::vector<double> pts_s;             // Of each record; its own time_s where the stream has no presentation times.
  int st0601 = 0;                        // Sets that were used, by kind.
  int eg0104 = 0;
  int other_keys = 0;
  int bad_checksums = 0;
  int without_checksum = 0;  // ST 0601 sets that bring none: used.
  int impossible = 0;        // Packets or items whose length cannot be: not used.
  int cut_short = 0;
  int error_values = 0;  // Items that say that they are out of range or unknown.
  int ill_formed = 0;    // Items of a wrong length or out of range.
  bool limit_reached = false;
  std::string first_problem;  // In words, with the packet's number.
  std::string first_bad_checksum;
  std::string sensor_name;  // Tag 11, or tag 10.
  // Where time_s comes from, in words.
  std::string clock;
  bool counts_from_first = false;  // No presentation times: time_s is 0 at the first record.

  // Records from which a pose or corners can be made.
  int usable() const;
};

// Reads one data stream piece by piece.
class KlvStreamReader {
 public:
  KlvStreamReader();
  KlvStreamReader(const KlvStreamReader&) = delete;
  KlvStreamReader& operator=(const KlvStreamReader&) = delete;

  // A piece of the stream and its presentation time on the clock of the frames.
  void Feed(Bytes piece, std::optional<double> pts_s) { splitter_.Feed(piece, pts_s); }
  // Gives the records their times: the precision time stamps, brought to the frames' clock by a line fitted through (stamp, presentation
  // time), so that the multiplexer's jitter and the stamps' steps average out; presentation times where stamps are absent, stand still or
  // do not follow a line to `tolerance_s`; stamps from the first on where there are no presentation times.
  KlvStreamContent Finish(double tolerance_s = 0.25);

 private:
  void Consume(const KlvPacket& packet);
  void SetTimes(double tolerance_s);

  KlvSplitter splitter_;
  KlvStreamContent content_;
  std::vector<std::optional<double>> pts_s_;
  int packets_ = 0;
};

}  // namespace trem
