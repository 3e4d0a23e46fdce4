#include "coordinator/scheduling/job_graph.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// Guessed shares of the work by stage. They only pace a progress bar.
constexpr std::array<double, 5> kShares = {0.03, 0.75, 0.04, 0.13, 0.05};
// A status message carries at most this many notes; one more says how many were left out.
constexpr std::size_t kStatusNotesMax = 2000;

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
  const v1::TaskSpec spec = PlanTask(inputs_, kind, index);
  const TaskPlace place{kind, index};
  TREM_CHECK(pending_.emplace(place, spec.key()).second);
  planned->push_back({place, spec.key(), spec.memory_bytes()});
}

Result<std::vector<PlannedTask>> JobGraph::Finish(const TaskPlace& place, const FinishedTask& finished) {
  TREM_CHECK_MSG(pending_.erase(place) == 1, TaskTitle(place.kind, place.index) + " is not pending");
  Stage& current = stage(place.kind);
  ++current.done;
  current.elapsed_ms += finished.elapsed_ms;
  peak_memory_bytes_ = std::max(peak_memory_bytes_, finished.peak_memory_bytes);
  for (const v1::Note& note : finished.result.notes()) AddNote(note);
  if (place.kind == v1::ENHANCE) {
    inputs_.window_pbs[place.index] = finished.result.outputs(0);
    inputs_.window_pb_bytes += finished.result.outputs(0).bytes();
  }
  if (place.kind == v1::COMPOSITE) inputs_.tiles[place.index] = finished.result.outputs(0);
  if (current.done < current.total) return std::vector<PlannedTask>{};
  return Unfold(place.kind, finished.result);
}

Result<std::vector<PlannedTask>> JobGraph::Unfold(v1::TaskKind finished_kind, const v1::TaskResult& result) {
  std::vector<PlannedTask> planned;
  switch (finished_kind) {
    case v1::INGEST: {
      inputs_.ingest = result.ingest();
      inputs_.manifest = result.outputs(0);
      TREM_ASSIGN_OR_RETURN(inputs_.windows, PlanWindows(inputs_.sortie, inputs_.ingest));
      inputs_.window_pbs.resize(inputs_.windows.size());
      stage(v1::ENHANCE).total = static_cast<std::uint32_t>(inputs_.windows.size());
      for (const WindowPlan& window : inputs_.windows) Plan(v1::ENHANCE, window.window_id, &planned);
      break;
    }
    case v1::ENHANCE:
      Plan(v1::ALIGN, 0, &planned);
      break;
    case v1::ALIGN: {
      inputs_.align = result.align();
      inputs_.alignment = result.outputs(0);
      const std::uint32_t tile_count = inputs_.align.tile_count();
      inputs_.tiles.resize(tile_count);
      stage(v1::COMPOSITE).total = tile_count;
      for (std::uint32_t i = 0; i < tile_count; ++i) Plan(v1::COMPOSITE, i, &planned);
      break;
    }
    case v1::COMPOSITE:
      Plan(v1::EXPORT, 0, &planned);
      break;
    default:
      outputs_.assign(result.outputs().begin(), result.outputs().end());
  }
  return planned;
}

void JobGraph::AddNote(const v1::Note& note) {
  notes_.try_emplace({note.code(), note.subject(), note.message(), static_cast<int>(note.severity())}, note);
}

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
    if (stages_[i].total > 0) fraction += kShares[i] * (stages_[i].done + running_fraction[i]) / stages_[i].total;
  }
  status->set_fraction(done() ? 1.0 : std::min(fraction, 1.0));
  status->set_eta_s(done() ? 0.0 : EstimateRemainingSeconds(running_fraction, worker_count));
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
  status->set_peak_memory_bytes(peak_memory_bytes_);
  status->set_retries(retries_);
}

double JobGraph::EstimateRemainingSeconds(const std::array<double, kStageCount>& running_fraction, std::uint32_t worker_count) const {
  const Stage& enhance = stage(v1::ENHANCE);
  if (enhance.done == 0 || worker_count == 0) return -1.0;
  const double enhance_ms = static_cast<double>(enhance.elapsed_ms) / enhance.done * enhance.total;
  double remaining_ms = 0.0;
  for (std::size_t i = 0; i < kStageCount; ++i) {
    const Stage& s = stages_[i];
    const double share_ms = enhance_ms * kShares[i] / kShares[static_cast<std::size_t>(v1::ENHANCE) - 1];
    if (s.total == 0) {  // Not unfolded yet: assume that it spreads over all workers.
      remaining_ms += share_ms / worker_count;
      continue;
    }
    const double left = std::max(0.0, s.total - s.done - running_fraction[i]);
    const double mean_ms = s.done > 0 ? static_cast<double>(s.elapsed_ms) / s.done : share_ms / s.total;
    const double side_by_side = std::max(1.0, std::min<double>(worker_count, s.total - s.done));
    remaining_ms += left * mean_ms / side_by_side;
  }
  return remaining_ms / 1000.0;
}

}  // namespace trem
