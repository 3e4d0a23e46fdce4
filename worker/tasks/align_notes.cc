#include "worker/tasks/align_notes.h"

#include <algorithm>
#include <iomanip>
#include <set>
#include <sstream>
#include <tuple>

namespace trem {
namespace {

std::string FrameName(const v1::SortieManifest& manifest, std::uint32_t index) {
  return index < static_cast<std::uint32_t>(manifest.frames_size()) ? manifest.frames(static_cast<int>(index)).name()
                                                                    : "#" + std::to_string(index);
}

std::string Rounded(double value, int digits) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(digits) << value;
  return text.str();
}

// One note for each run of successive frames that were lost for the same reason.
void AddLostFrames(const v1::SortieManifest& manifest, const FrameCensus& census, std::vector<v1::Note>& notes) {
  for (auto first = census.lost.begin(); first != census.lost.end();) {
    auto last = first;
    auto next = std::next(first);
    std::uint32_t count = 1;
    while (next != census.lost.end() && next->first == last->first + 1 && next->second == first->second) {
      last = next++;
      ++count;
    }
    const std::string subject = count == 1 ? "frame " + FrameName(manifest, first->first)
                                           : "frames " + FrameName(manifest, first->first) + " to " + FrameName(manifest, last->first);
    notes.push_back(MakeNote("frames_lost", subject,
                             std::to_string(count) + (count == 1 ? " frame is" : " frames are") +
                                 " not in the mosaic, registered in no window: " + first->second,
                             v1::WARNING));
    first = next;
  }
  if (census.lost_in_part.empty()) return;
  std::ostringstream text;
  text << "some windows lost frames that others registered:";
  for (const auto& [reason, count] : census.lost_in_part) text << " " << count << " times " << reason << ";";
  std::string message = text.str();
  message.pop_back();
  notes.push_back(MakeNote("frames_lost_in_part", "", message, v1::INFO));
}

void AddPieces(const v1::SortieManifest& manifest, const align::AlignSolution& solution, std::vector<v1::Note>& notes) {
  if (solution.join_count > 0) {
    notes.push_back(MakeNote("pieces_joined", "",
                             std::to_string(solution.join_count) + " pieces that share no frame were joined by what they show", v1::INFO));
  }
  if (solution.piece_count < 2) return;
  std::map<int, std::pair<std::uint32_t, std::uint32_t>> span;
  for (const align::AlignedFrame& frame : solution.frames) {
    const auto [found, fresh] = span.try_emplace(frame.piece, frame.frame, frame.frame);
    if (!fresh) found->second.second = frame.frame;
  }
  std::ostringstream text;
  text << "the mosaic has " << solution.piece_count << " pieces without a common frame or common ground";
  int listed = 0;
  for (const auto& [piece, frames] : span) {
    if (++listed > 10) {
      text << "; and " << span.size() - 10 << " more";
      break;
    }
    text << (listed == 1 ? ": " : "; ") << piece << ": " << FrameName(manifest, frames.first) << " to "
         << FrameName(manifest, frames.second);
  }
  text << (solution.georeferenced ? ". Telemetry alone relates them" : ". Their relative placement, side by side, is arbitrary");
  notes.push_back(MakeNote("pieces", "", text.str(), v1::WARNING));
}

void AddOutliers(const v1::SortieManifest& manifest, const align::AlignSolution& solution, std::vector<v1::Note>& notes) {
  if (solution.outlier_ties.empty()) return;
  std::vector<align::OutlierTie> worst = solution.outlier_ties;
  std::stable_sort(worst.begin(), worst.end(),
                   [](const align::OutlierTie& a, const align::OutlierTie& b) { return a.error_px > b.error_px; });
  std::ostringstream text;
  text << worst.size() << " of the views contradict the others and were down-weighted; the worst:";
  for (std::size_t k = 0; k < std::min<std::size_t>(10, worst.size()); ++k) {
    text << (k == 0 ? " " : ", ") << "frame " << FrameName(manifest, worst[k].frame) << " in window " << worst[k].window_id << " (scene "
         << worst[k].scene_id << ", " << Rounded(worst[k].error_px, 2) << " px)";
  }
  notes.push_back(MakeNote("outlier_ties", "", text.str(), v1::INFO));
}

std::string FitText(const align::ControlFit& fit) {
  return std::to_string(fit.point_count) + " points: RMSE " + Rounded(fit.rmse_m, 3) + " m, CE90 " + Rounded(fit.ce90_m, 3) + " m";
}

void AddControl(const v1::SortieManifest& manifest, const align::AlignSolution& solution, std::vector<v1::Note>& notes) {
  const align::ControlReport& control = solution.control;
  if (manifest.control_size() > 0 && !solution.georeferenced) {
    notes.push_back(MakeNote("control_unused", "",
                             "ground control is not used without telemetry: nothing places the mosaic near the points", v1::WARNING));
    return;
  }
  if (control.constraints.point_count > 0) {
    notes.push_back(MakeNote("control", "", "the mosaic fits ground control, " + FitText(control.constraints), v1::INFO));
  }
  if (control.checks.point_count > 0) {
    notes.push_back(MakeNote("control_check", "", "against ground control that was held out, " + FitText(control.checks), v1::INFO));
  }
  std::map<std::string, std::string> outliers;
  for (const align::AlignedControl& point : control.observations) {
    if (!point.outlier) continue;
    std::string& text = outliers[point.name];
    text += (text.empty() ? "" : ", ") + Rounded(point.error_m.norm(), 2) + " m off in frame " + FrameName(manifest, point.frame);
  }
  for (const auto& [name, text] : outliers) {
    notes.push_back(MakeNote("control_outlier", "control point " + name,
                             "control point " + name + " contradicts telemetry and the other points and was given no weight: " + text +
                                 "; check its coordinates (longitude before latitude, WGS 84), its frame and its pixel",
                             v1::WARNING));
  }
  if (control.unseen.empty()) return;
  std::string names;
  for (const std::string& name : control.unseen) names += (names.empty() ? "" : ", ") + name;
  notes.push_back(MakeNote("control_unseen", "", "no placed frame shows these control points, which are not used: " + names, v1::WARNING));
}

void AddOutlierPairs(const align::AlignSolution& solution, std::vector<v1::Note>& notes) {
  if (solution.outlier_pairs.empty()) return;
  std::ostringstream text;
  text << solution.outlier_pairs.size() << " pairs of scenes seemed to show the same ground and contradict the others:";
  for (std::size_t k = 0; k < std::min<std::size_t>(10, solution.outlier_pairs.size()); ++k) {
    const align::OutlierPair& pair = solution.outlier_pairs[k];
    text << (k == 0 ? " " : ", ") << "scene " << pair.scene_a << " of window " << pair.window_a << " and scene " << pair.scene_b
         << " of window " << pair.window_b << " (" << Rounded(pair.error_px, 1) << " px)";
  }
  notes.push_back(MakeNote("outlier_pairs", "", text.str(), v1::INFO));
}

void AddLeftOutScenes(const std::vector<align::AlignedScene>& scenes, const std::string& code, const std::string& why,
                      std::vector<v1::Note>& notes) {
  if (scenes.empty()) return;
  std::ostringstream text;
  text << scenes.size() << (scenes.size() == 1 ? " enhanced scene is" : " enhanced scenes are") << " left out of the mosaic: " << why
       << ":";
  for (std::size_t k = 0; k < std::min<std::size_t>(10, scenes.size()); ++k) {
    text << (k == 0 ? " " : ", ") << "scene " << scenes[k].scene_id << " of window " << scenes[k].window_id;
  }
  if (scenes.size() > 10) text << " and " << scenes.size() - 10 << " more";
  notes.push_back(MakeNote(code, "", text.str(), v1::WARNING));
}

}  // namespace

FrameCensus CountFrames(const v1::SortieManifest& manifest, const std::vector<v1::WindowResult>& windows) {
  std::set<std::uint32_t> registered;
  std::map<std::uint32_t, std::map<std::string, std::uint32_t>> reasons;
  for (const v1::WindowResult& window : windows) {
    for (const v1::FrameOutcome& frame : window.frames()) {
      if (frame.outcome() == v1::REGISTERED || frame.outcome() == v1::STARTED_SCENE) registered.insert(frame.frame_index());
      if (frame.outcome() == v1::LOST) ++reasons[frame.frame_index()][frame.reason().empty() ? "could not be registered" : frame.reason()];
    }
  }
  FrameCensus census;
  census.registered = static_cast<std::uint32_t>(registered.size());
  for (const auto& [frame, counts] : reasons) {
    const bool usable =
        frame < static_cast<std::uint32_t>(manifest.frames_size()) && manifest.frames(static_cast<int>(frame)).state() == v1::FRAME_USABLE;
    if (registered.count(frame) > 0) {
      for (const auto& [reason, count] : counts) census.lost_in_part[reason] += count;
    } else if (usable) {
      census.lost[frame] =
          std::max_element(counts.begin(), counts.end(), [](const auto& a, const auto& b) { return a.second < b.second; })->first;
    }
  }
  return census;
}

std::string NothingEnhancedText(const FrameCensus& census) {
  std::map<std::string, std::uint32_t> counts;
  for (const auto& [frame, reason] : census.lost) ++counts[reason];
  std::ostringstream text;
  text << "no window gave an enhanced scene: " << census.lost.size() << " frames were lost";
  const char* separator = " (";
  for (const auto& [reason, count] : counts) {
    text << separator << count << ": " << reason;
    separator = "; ";
  }
  if (!counts.empty()) text << ")";
  text << ". Look at the frames with trem inspect; try a larger windows.roi_px for fast motion, or fewer, sharper frames "
          "(source.first_frame, "
          "source.max_frames)";
  return text.str();
}

std::vector<v1::Note> AlignNotes(const v1::Sortie& sortie, const v1::SortieManifest& manifest, const FrameCensus& census,
                                 const AlignTaskInput& input, const align::AlignSolution& solution) {
  std::vector<v1::Note> notes = input.notes;
  AddLostFrames(manifest, census, notes);
  AddPieces(manifest, solution, notes);
  AddOutliers(manifest, solution, notes);
  AddOutlierPairs(solution, notes);
  AddControl(manifest, solution, notes);
  AddLeftOutScenes(solution.unplaced_scenes, "scenes_without_place", "nothing connects them to a frame with telemetry", notes);
  AddLeftOutScenes(solution.insane_scenes, "scenes_not_credible",
                   "their scale is off by more than 8 times in area, or they reach the horizon", notes);
  if (!solution.horizon_frames.empty()) {
    notes.push_back(MakeNote("horizon", "frame " + FrameName(manifest, solution.horizon_frames.front()),
                             "by their telemetry " + std::to_string(solution.horizon_frames.size()) +
                                 " frames see the horizon or nearly so in some windows; they were left out there",
                             v1::WARNING));
  }
  if (solution.georeferenced) {
    notes.push_back(MakeNote("georeferenced", "", "placed by telemetry; gauge: " + solution.gauge, v1::INFO));
  } else {
    notes.push_back(MakeNote("local_coordinates", "",
                             "the mosaic is not georeferenced: " +
                                 std::string(input.telemetry ? "no registered frame has telemetry" : "there is no usable telemetry") +
                                 (sortie.mosaic().crs().empty() ? "" : ", so mosaic.crs was not used") + ". Gauge: " + solution.gauge,
                             v1::WARNING));
  }
  std::ostringstream fit;
  fit << solution.scenes.size() << " scenes and " << solution.frames.size() << " frames (" << solution.used_frame_count
      << " as unknowns); ties fit to " << Rounded(solution.tie_rms_px, 3) << " px (variance factor " << Rounded(solution.variance_factor, 2)
      << "), " << solution.content_tie_count << " pairs of scenes tied by content (" << solution.content_outlier_count << " of "
      << solution.content_point_count << " points rejected)";
  notes.push_back(MakeNote("alignment", "", fit.str(), v1::INFO));
  std::sort(notes.begin(), notes.end(), [](const v1::Note& a, const v1::Note& b) {
    return std::tie(a.code(), a.subject(), a.message()) < std::tie(b.code(), b.subject(), b.message());
  });
  return notes;
}

}  // namespace trem
