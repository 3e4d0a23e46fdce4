#include "coordinator/scheduling/job_graph.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// Guessed shares of the work by stage. They only pace a progress bar.
constexpr std::array<double, 5> kShares = {0.03, 0.75, 0.04, 0.13, 0.05};
// A status message carries at most this many notes; one more says how many were left out.
constexpr std::size_t kStatusNotesMax = 2000;
// Neighbouring tiles of a row, which mostly read the same scenes.
constexpr std::uint32_t kTilesSideBySide = 8;

v1::Note HoleNote(const TaskPlace& place, const Status& reason) {
  v1::Note note;
  note.set_code("task_given_up");
  note.set_subject(TaskTitle(place.kind, place.index));
  note.set_message("is missing: " + reason.message());
  note.set_severity(v1::WARNING);
  return note;
}

std::tuple<std::string, std::string, std::string, int> OrderOf(const v1::Note& note) {
  return {note.code(), note.subject(), note.message(), static_cast<int>(note.severity())};
}

double Squared(std::uint64_t ms) { return static_cast<double>(ms) * static_cast<double>(ms); }

}  // namespace

JobGraph::JobGraph(std::string job_id, v1::Sortie sortie) {
  inputs_.job_id = std::move(job_id);
  inputs_.sortie = std::move(sortie);
  for (const v1::TaskKind kind : {v1::INGEST, v1::ALIGN, v1::EXPORT}) stage(kind).total = 1;
}

PlannedTask JobGraph::Start() {
  std::vector<PlannedTask> planned;
  Plan(v1::INGEST, 0, &planned);
  return planned.front();
}

void JobGraph::Plan(v1::TaskKind kind, std::uint32_t index, std::vector<PlannedTask>* planned) {
  Stage& s = stage(kind);
  if (s.pending.size() < s.total) s.pending.resize(s.total, false);
  TREM_CHECK(index < s.total && !s.pending[index]);
  s.pending[index] = true;
  PlannedKey key = PlanTaskKey(inputs_, kind, index);
  std::uint32_t locality = 0;
  if (kind == v1::ENHANCE) locality = inputs_.windows[index].frame_begin;
  if (kind == v1::COMPOSITE) locality = index / kTilesSideBySide;
  planned->push_back({{kind, index}, std::move(key.key), key.memory_bytes, locality});
}

Result<std::vector<PlannedTask>> JobGraph::Finish(const TaskPlace& place, const FinishedTask& finished) {
  TREM_CHECK_MSG(IsPending(place), TaskTitle(place.kind, place.index) + " is not pending");
  Stage& current = stage(place.kind);
  current.pending[place.index] = false;
  ++current.done;
  current.elapsed_ms += finished.elapsed_ms;
  current.elapsed_ms2 += Squared(finished.elapsed_ms);
  peak_memory_bytes_ = std::max(peak_memory_bytes_, finished.peak_memory_bytes);
  for (const v1::Note& note : finished.result.notes()) {
    AddNote(note);
    task_notes_.try_emplace(OrderOf(note), note);
    if (place.kind == v1::EXPORT && note.hole()) empty_.emplace(note);
  }
  SetOutput(place, finished.result);
  return UnfoldWhenComplete(place.kind);
}

void JobGraph::SetOutput(const TaskPlace& place, const v1::TaskResult& result) {
  switch (place.kind) {
    case v1::INGEST:
      inputs_.ingest = result.ingest();
      inputs_.manifest = result.outputs(0);
      inputs_.recordings.assign(result.outputs().begin() + 1, result.outputs().end());
      break;
    case v1::ENHANCE:
      inputs_.window_pbs[place.index] = result.outputs(0);
      inputs_.window_pb_bytes += result.outputs(0).bytes();
      break;
    case v1::ALIGN:
      inputs_.align = result.align();
      inputs_.alignment = result.outputs(0);
      break;
    case v1::COMPOSITE:
      inputs_.tiles[place.index] = result.outputs(0);
      break;
    default:
      outputs_.assign(result.outputs().begin(), result.outputs().end());
  }
}

Result<std::vector<PlannedTask>> JobGraph::GiveUp(const TaskPlace& place, const Status& reason) {
  TREM_CHECK_MSG(IsPending(place), TaskTitle(place.kind, place.index) + " is not pending");
  if (place.kind != v1::ENHANCE && place.kind != v1::COMPOSITE) return reason;
  Stage& current = stage(place.kind);
  current.pending[place.index] = false;
  ++current.holes;
  holes_.insert_or_assign(place, reason);
  if (current.holes == current.total) {
    return holes_.lower_bound({place.kind, 0})
        ->second.WithPrefix("all " + std::to_string(current.total) + " " + v1::TaskKind_Name(place.kind) + " tasks failed; the first one");
  }
  return UnfoldWhenComplete(place.kind);
}

void JobGraph::Reopen(const TaskPlace& place, const FinishedTask& finished) {
  Stage& current = stage(place.kind);
  TREM_CHECK(place.index < current.pending.size() && !current.pending[place.index] && current.done > 0);
  current.pending[place.index] = true;
  --current.done;
  current.elapsed_ms -= finished.elapsed_ms;
  current.elapsed_ms2 -= Squared(finished.elapsed_ms);
  if (place.kind == v1::ENHANCE) inputs_.window_pb_bytes -= finished.result.outputs(0).bytes();
}

Result<std::vector<PlannedTask>> JobGraph::UnfoldWhenComplete(v1::TaskKind kind) {
  Stage& current = stage(kind);
  if (current.is_unfolded || current.done + current.holes < current.total) return std::vector<PlannedTask>{};
  current.is_unfolded = true;
  return Unfold(kind);
}

Result<std::vector<PlannedTask>> JobGraph::Unfold(v1::TaskKind finished_kind) {
  std::vector<PlannedTask> planned;
  switch (finished_kind) {
    case v1::INGEST: {
      TREM_ASSIGN_OR_RETURN(inputs_.windows, PlanWindows(inputs_.sortie, inputs_.ingest));
      inputs_.window_pbs.resize(inputs_.windows.size());
      stage(v1::ENHANCE).total = static_cast<std::uint32_t>(inputs_.windows.size());
      planned.reserve(inputs_.windows.size());
      for (const WindowPlan& window : inputs_.windows) Plan(v1::ENHANCE, window.window_id, &planned);
      break;
    }
    case v1::ENHANCE:
      inputs_.window_pbs_digest = WindowsDigest(inputs_.window_pbs);
      Plan(v1::ALIGN, 0, &planned);
      break;
    case v1::ALIGN: {
      for (const v1::TileInputs& tile : inputs_.align.tiles()) {
        for (const std::uint32_t window_id : tile.window_ids()) {
          if (window_id < inputs_.windows.size()) continue;
          return Failed("the ALIGN task named window " + std::to_string(window_id) + "; the job has " +
                        std::to_string(inputs_.windows.size()) + " windows");
        }
      }
      const std::uint32_t tile_count = inputs_.align.tile_count();
      inputs_.tiles.resize(tile_count);
      stage(v1::COMPOSITE).total = tile_count;
      planned.reserve(tile_count);
      for (std::uint32_t i = 0; i < tile_count; ++i) Plan(v1::COMPOSITE, i, &planned);
      break;
    }
    case v1::COMPOSITE:
      for (const auto& [place, reason] : holes_) inputs_.holes.push_back(HoleNote(place, reason));
      for (const auto& [order, note] : task_notes_) inputs_.notes.push_back(note);
      Plan(v1::EXPORT, 0, &planned);
      break;
    default:
      break;
  }
  return planned;
}

std::optional<double> JobGraph::MeanElapsedMs(v1::TaskKind kind) const {
  const Stage& s = stage(kind);
  if (s.done < 3 || 2 * s.done < s.total) return std::nullopt;
  return static_cast<double>(s.elapsed_ms) / s.done;
}

void JobGraph::AddNote(const v1::Note& note) { notes_.try_emplace(OrderOf(note), note); }

void JobGraph::FillStatus(const std::vector<std::pair<TaskPlace, double>>& running, std::uint32_t worker_count,
                          v1::JobStatus* status) const {
  std::array<double, kStageCount> running_fraction{};
  std::array<std::uint32_t, kStageCount> running_count{};
  for (const auto& [place, fraction] : running) {
    running_fraction[static_cast<std::size_t>(place.kind) - 1] += fraction;
    ++running_count[static_cast<std::size_t>(place.kind) - 1];
  }
  double fraction = 0.0;
  for (std::size_t i = 0; i < kStageCount; ++i) {
    v1::StageStatus* message = status->add_stages();
    message->set_kind(static_cast<v1::TaskKind>(i + 1));
    message->set_total(stages_[i].total);
    message->set_done(stages_[i].done);
    message->set_running(running_count[i]);
    message->set_running_fraction(running_fraction[i]);
    message->set_elapsed_ms(stages_[i].elapsed_ms);
    if (stages_[i].total > 0) fraction += kShares[i] * (stages_[i].done + stages_[i].holes + running_fraction[i]) / stages_[i].total;
  }
  status->set_fraction(done() ? 1.0 : std::min(fraction, 1.0));
  const RemainingTime remaining = done() ? RemainingTime{0.0, 0.0, 0.0} : EstimateRemaining(running_fraction, worker_count);
  status->set_eta_s(remaining.s);
  status->set_eta_low_s(remaining.low_s);
  status->set_eta_high_s(remaining.high_s);
  for (const v1::ArtefactRef& output : outputs_) *status->add_outputs() = output;
  for (const auto& [key, note] : notes_) {
    if (static_cast<std::size_t>(status->notes_size()) == kStatusNotesMax) {
      v1::Note* rest = status->add_notes();
      rest->set_code("notes_left_out");
      rest->set_message(std::to_string(notes_.size() - kStatusNotesMax) + " more notes are not listed");
      break;
    }
    *status->add_notes() = note;
  }
  for (const auto& [place, reason] : holes_) {
    if (static_cast<std::size_t>(status->holes_size()) == kStatusNotesMax) break;
    *status->add_holes() = HoleNote(place, reason);
  }
  if (empty_) *status->add_holes() = *empty_;
  status->set_peak_memory_bytes(peak_memory_bytes_);
  status->set_retries(retries_);
}

RemainingTime JobGraph::EstimateRemaining(const std::array<double, kStageCount>& running_fraction, std::uint32_t worker_count) const {
  std::array<StageLoad, kStageCount> loads;
  for (std::size_t i = 0; i < kStageCount; ++i) {
    const Stage& s = stages_[i];
    loads[i] = {kShares[i],
                i + 1 == static_cast<std::size_t>(v1::ENHANCE),
                s.total,
                s.done,
                s.holes,
                running_fraction[i],
                static_cast<double>(s.elapsed_ms),
                s.elapsed_ms2};
  }
  return EstimateRemainingTime(loads, worker_count);
}

}  // namespace trem
