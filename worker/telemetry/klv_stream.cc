#include "worker/telemetry/klv_stream.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "worker/telemetry/klv_sets.h"

namespace trem {
namespace {

constexpr double kMicro = 1e-6;

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct ClockLine {
  double slope = 1.0;  // Presentation seconds per stamp second.
  double offset_s = 0.0;
  double residual_s = 0.0;  // 95 % of the points are nearer.
};

// A line through (x, y): slope by least squares, then offset by the median, which a burst of late packets does not move.
ClockLine FitLine(const std::vector<double>& x, const std::vector<double>& y) {
  const double n = static_cast<double>(x.size());
  const double mx = std::accumulate(x.begin(), x.end(), 0.0) / n;
  const double my = std::accumulate(y.begin(), y.end(), 0.0) / n;
  double xx = 0.0;
  double xy = 0.0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    xx += (x[i] - mx) * (x[i] - mx);
    xy += (x[i] - mx) * (y[i] - my);
  }
  ClockLine line;
  if (xx > 0.0) line.slope = xy / xx;
  std::vector<double> offsets(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) offsets[i] = y[i] - line.slope * x[i];
  line.offset_s = Median(offsets);
  for (double& value : offsets) value = std::abs(value - line.offset_s);
  std::sort(offsets.begin(), offsets.end());
  line.residual_s = offsets[static_cast<std::size_t>(0.95 * (n - 1.0))];
  return line;
}

}  // namespace

int KlvStreamContent::usable() const {
  return static_cast<int>(std::count_if(records.begin(), records.end(), [](const TelemetryRecord& record) {
    return record.corners.has_value() || (record.HasPosition() && record.HasPointing());
  }));
}

KlvStreamReader::KlvStreamReader() : splitter_([this](const KlvPacket& packet) { Consume(packet); }) {}

void KlvStreamReader::Consume(const KlvPacket& packet) {
  const int number = packets_++;
  KlvSet set;
  const bool universal = IsEg0104(packet.key);
  const KlvVerdict verdict = universal ? ReadEg0104(packet, &set) : ReadSt0601(packet, &set);
  const auto report = [&] {
    if (content_.first_problem.empty()) content_.first_problem = "KLV packet " + std::to_string(number) + ": " + set.first_problem;
  };
  switch (verdict) {
    case KlvVerdict::kOtherKey:
      ++content_.other_keys;
      return;
    case KlvVerdict::kBadChecksum:
      ++content_.bad_checksums;
      if (content_.first_bad_checksum.empty())
        content_.first_bad_checksum = "KLV packet " + std::to_string(number) + ": " + set.first_problem;
      return;
    case KlvVerdict::kImpossibleItems:
      ++content_.impossible;
      report();
      return;
    case KlvVerdict::kGood:
      break;
  }
  if (content_.records.size() == kTelemetryRecordsMax) {
    content_.limit_reached = true;
    return;
  }
  ++(universal ? content_.eg0104 : content_.st0601);
  if (!universal && !HasChecksum(set)) ++content_.without_checksum;
  content_.error_values += set.error_values;
  content_.ill_formed += set.ill_formed;
  if (set.ill_formed > 0) report();
  for (const int tag : {11, 10}) {
    const auto name = set.texts.find(tag);
    if (content_.sensor_name.empty() && name != set.texts.end()) content_.sensor_name = name->second;
  }
  content_.records.push_back(RecordFromKlv(set));
  pts_s_.push_back(packet.pts_s);
}

void KlvStreamReader::SetTimes(double tolerance_s) {
  std::vector<TelemetryRecord>& records = content_.records;
  std::vector<double> stamps;
  std::vector<double> presented;
  const std::int64_t first_us = [&] {
    for (const TelemetryRecord& record : records) {
      if (record.utc_us.has_value()) return *record.utc_us;
    }
    return std::int64_t{0};
  }();
  const auto stamp = [&](const TelemetryRecord& record) { return kMicro * static_cast<double>(*record.utc_us - first_us); };
  std::size_t with_stamp = 0;
  std::size_t with_pts = 0;
  for (std::size_t i = 0; i < records.size(); ++i) {
    with_stamp += records[i].utc_us.has_value() ? 1 : 0;
    with_pts += pts_s_[i].has_value() ? 1 : 0;
    if (!records[i].utc_us.has_value() || !pts_s_[i].has_value()) continue;
    stamps.push_back(stamp(records[i]));
    presented.push_back(*pts_s_[i]);
  }
  const bool all_stamps = with_stamp == records.size();
  ClockLine line;
  bool by_stamp = false;
  if (all_stamps && with_pts == 0) {
    by_stamp = true;
    content_.counts_from_first = true;
    content_.clock = "precision time stamps from the first on (the stream has no presentation times)";
  } else if (all_stamps && stamps.size() >= 2) {
    const auto [low, high] = std::minmax_element(stamps.begin(), stamps.end());
    line = FitLine(stamps, presented);
    by_stamp = *high > *low && line.slope > 0.5 && line.slope < 2.0 && line.residual_s <= tolerance_s;
    content_.clock = by_stamp ? fmt::format("precision time stamps, brought to presentation time (rate {:.4f}, 95 % within {:.0f} ms)",
                                            line.slope, 1e3 * line.residual_s)
                              : "presentation times (the precision time stamps stand still or do not follow them)";
  } else {
    content_.clock = "presentation times";
  }
  std::vector<TelemetryRecord> timed;
  std::vector<double> timed_pts;
  for (std::size_t i = 0; i < records.size(); ++i) {
    if (!by_stamp && !pts_s_[i].has_value()) continue;
    records[i].time_s = by_stamp ? line.offset_s + line.slope * stamp(records[i]) : *pts_s_[i];
    timed.push_back(records[i]);
    timed_pts.push_back(pts_s_[i].value_or(records[i].time_s));
  }
  // In the order of time; of several for one moment the first.
  std::vector<std::size_t> order(timed.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return timed[a].time_s < timed[b].time_s; });
  records.clear();
  for (const std::size_t i : order) {
    if (!records.empty() && timed[i].time_s <= records.back().time_s) continue;
    records.push_back(timed[i]);
    content_.pts_s.push_back(timed_pts[i]);
  }
}

KlvStreamContent KlvStreamReader::Finish(double tolerance_s) {
  splitter_.Finish();
  content_.impossible += static_cast<int>(splitter_.impossible_lengths());
  content_.cut_short = static_cast<int>(splitter_.cut_short());
  if (content_.first_problem.empty()) content_.first_problem = splitter_.first_problem();
  SetTimes(tolerance_s);
  return std::move(content_);
}

}  // namespace trem
