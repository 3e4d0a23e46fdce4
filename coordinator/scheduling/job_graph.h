#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/remaining_time.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// A task's place in a job. The order of places is the order of work.
struct TaskPlace {
  v1::TaskKind kind = v1::INGEST;
  std::uint32_t index = 0;  // Window id, tile index or 0.
  friend bool operator==(const TaskPlace&, const TaskPlace&) = default;
  friend bool operator<(const TaskPlace& a, const TaskPlace& b) { return std::tie(a.kind, a.index) < std::tie(b.kind, b.index); }
};

// A task that has become known: everything before it is done.
struct PlannedTask {
  TaskPlace place;
  std::string key;
  std::uint64_t memory_bytes = 0;
  // Tasks of a stage with the same number read the same frames (ENHANCE) or neighbouring scenes (COMPOSITE).
  std::uint32_t locality = 0;
};

// How a finished task went.
struct FinishedTask {
  v1::TaskResult result;
  std::uint64_t elapsed_ms = 0;
  std::uint64_t peak_memory_bytes = 0;
};

// The stages Ingest -> Enhance* -> Align -> Composite* -> Export of one job, unfolded as results arrive. An Enhance or Composite task may
// be given up: it becomes a hole, and what follows is made of the others. Pure: knows nothing of workers, attempts or other jobs. Cost:
// O(log n) a result, plus O(n) once when a stage of n tasks is unfolded.
class JobGraph {
 public:
  JobGraph(std::string job_id, v1::Sortie sortie);

  // The first task. Call once.
  PlannedTask Start();
  // Takes the result of a pending task and returns the tasks that have become known. An error means that the job cannot go on.
  Result<std::vector<PlannedTask>> Finish(const TaskPlace& place, const FinishedTask& finished);
  // Goes on without a pending task, for this reason. An error means that nothing is left to go on with, or that the stage cannot have
  // holes.
  Result<std::vector<PlannedTask>> GiveUp(const TaskPlace& place, const Status& reason);
  // Takes a result back: the task is pending again. Tasks that became known through it stay known, because a repeated task gives the same
  // bytes.
  void Reopen(const TaskPlace& place, const FinishedTask& finished);
  // The full message of a task that has become known.
  v1::TaskSpec Spec(const TaskPlace& place) const { return PlanTask(inputs_, place.kind, place.index); }

  bool IsPending(const TaskPlace& place) const {
    const Stage& s = stage(place.kind);
    return place.index < s.pending.size() && s.pending[place.index];
  }
  // What was given up, and why.
  const std::map<TaskPlace, Status>& holes() const { return holes_; }
  // Mean duration of the stage's finished tasks, once at least three and half of all are; nullopt before.
  std::optional<double> MeanElapsedMs(v1::TaskKind kind) const;
  bool done() const { return stage(v1::EXPORT).done == 1; }
  // Of a job that is done: whether something of its mosaic is missing.
  bool in_part() const { return !holes_.empty() || empty_.has_value(); }
  const v1::Sortie& sortie() const { return inputs_.sortie; }

  // Adds a note that no task reported.
  void AddNote(const v1::Note& note);
  // Counts a task that had to be handed out again.
  void AddRetry() { ++retries_; }

  // Fills in stages, outputs, notes, fraction, eta_s, peak memory and retries. `running`: fractions of the running tasks.
  //
  // fraction = sum over stages of share * (done + running fractions) / total, with fixed shares of the whole work. eta_s and its interval:
  // EstimateRemainingTime; < 0 until an Enhance task is done.
  void FillStatus(const std::vector<std::pair<TaskPlace, double>>& running, std::uint32_t worker_count, v1::JobStatus* status) const;

 private:
  struct Stage {
    std::uint32_t total = 0;
    std::uint32_t done = 0;
    std::uint32_t holes = 0;
    std::uint64_t elapsed_ms = 0;  // Sum over the done ones,
    double elapsed_ms2 = 0.0;      // and of the squares.
    bool is_unfolded = false;      // What follows it is known.
    std::vector<bool> pending;     // By index.
  };
  static constexpr int kStageCount = 5;

  Stage& stage(v1::TaskKind kind) { return stages_[static_cast<std::size_t>(kind) - 1]; }
  const Stage& stage(v1::TaskKind kind) const { return stages_[static_cast<std::size_t>(kind) - 1]; }
  void Plan(v1::TaskKind kind, std::uint32_t index, std::vector<PlannedTask>* planned);
  Result<std::vector<PlannedTask>> UnfoldWhenComplete(v1::TaskKind kind);
  Result<std::vector<PlannedTask>> Unfold(v1::TaskKind finished_kind);
  void SetOutput(const TaskPlace& place, const v1::TaskResult& result);
  RemainingTime EstimateRemaining(const std::array<double, kStageCount>& running_fraction, std::uint32_t worker_count) const;

  JobInputs inputs_;
  std::array<Stage, kStageCount> stages_;
  std::map<TaskPlace, Status> holes_;
  std::vector<v1::ArtefactRef> outputs_;
  using Notes = std::map<std::tuple<std::string, std::string, std::string, int>, v1::Note>;  // Sorted and unique.
  Notes notes_;
  Notes task_notes_;               // Those that tasks reported, which depend on the job alone.
  std::optional<v1::Note> empty_;  // What EXPORT says of a mosaic that nothing covers.
  std::uint64_t peak_memory_bytes_ = 0;
  std::uint32_t retries_ = 0;
};

}  // namespace trem
