#include "worker/sortie/spans.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "worker/sortie/frame_source.h"

namespace trem {
namespace {

constexpr double kGap_s = 2.0;
constexpr double kGapIntervals = 8.0;

std::vector<int> UsableFrames(const v1::SortieManifest& manifest) {
  std::vector<int> usable;
  for (int i = 0; i < manifest.frames_size(); ++i) {
    if (manifest.frames(i).state() == v1::FRAME_USABLE) usable.push_back(i);
  }
  return usable;
}

double MedianInterval(const v1::SortieManifest& manifest, const std::vector<int>& usable) {
  std::vector<double> intervals;
  for (std::size_t i = 1; i < usable.size(); ++i) {
    intervals.push_back(std::abs(manifest.frames(usable[i]).time_s() - manifest.frames(usable[i - 1]).time_s()));
  }
  if (intervals.empty()) return 0.0;
  const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2);
  std::nth_element(intervals.begin(), middle, intervals.end());
  return *middle;
}

std::string Decimal(double value) {
  const std::string text = std::to_string(value);
  return text.substr(0, text.find('.') + 3);
}

}  // namespace

void SplitIntoSpans(v1::SortieManifest* manifest) {
  manifest->clear_spans();
  const std::vector<int> usable = UsableFrames(*manifest);
  const double gap_s = std::max(kGap_s, kGapIntervals * MedianInterval(*manifest, usable));
  const auto note = [manifest](const std::string& code, int frame, const std::string& message) {
    *manifest->add_notes() = MakeNote(v1::WARNING, code, manifest->frames(frame).name(), "frame " + std::to_string(frame) + " " + message);
  };
  const auto close = [manifest, &note, &usable](std::size_t begin, std::size_t end) {
    if (end - begin < 2) {
      note("frame_alone", usable[begin], "can be registered to neither neighbour and is left out");
      return;
    }
    v1::FrameSpan* span = manifest->add_spans();
    span->set_begin(static_cast<std::uint32_t>(usable[begin]));
    span->set_end(static_cast<std::uint32_t>(usable[end - 1] + 1));
  };
  std::size_t begin = 0;
  for (std::size_t i = 1; i < usable.size(); ++i) {
    const v1::ManifestFrame& frame = manifest->frames(usable[i]);
    const double pause_s = std::abs(frame.time_s() - manifest->frames(usable[i - 1]).time_s());
    const bool is_cut = frame.motion_correlation() <= 0.0;
    const bool is_gap = pause_s > gap_s;
    if (!is_cut && !is_gap) continue;
    if (is_gap) note("time_gap", usable[i], "comes " + Decimal(pause_s) + " s after the frame before it; a new piece starts here");
    if (is_cut && !is_gap)
      note("cut", usable[i], "shows other ground than the frame before it, or it moved too far; a new piece starts here");
    close(begin, i);
    begin = i;
  }
  if (!usable.empty()) close(begin, usable.size());
}

}  // namespace trem
