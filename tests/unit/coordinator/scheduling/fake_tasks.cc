#include "tests/unit/coordinator/scheduling/fake_tasks.h"

#include <algorithm>
#include <string_view>

#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"

namespace trem::testing {

namespace {

constexpr std::string_view kSourceFolder = "/data/";

}  // namespace

std::string FakeSortieNameOf(const v1::TaskSpec& task) { return task.sortie().source().path().substr(kSourceFolder.size()); }

v1::Sortie FakeSortie(const std::string& name) {
  v1::Sortie sortie;
  sortie.set_name(name);
  sortie.mutable_source()->set_path(std::string(kSourceFolder) + name);
  sortie.mutable_tre()->set_ratio(3);
  sortie.mutable_windows()->set_roi_px(60);
  sortie.mutable_windows()->set_roi_overlap_px(10);
  sortie.mutable_windows()->set_frames(10);
  sortie.mutable_windows()->set_frame_overlap(2);
  sortie.mutable_mosaic()->set_tile_px(64);
  return sortie;
}

v1::TaskResult FakeResult(const v1::TaskSpec& spec, const std::string& source_content) {
  v1::TaskResult result;
  const std::string main = MainArtefactName(spec.kind());
  v1::ArtefactRef* output = result.add_outputs();
  output->set_name(main.empty() ? "mosaic.tif" : main);
  // A manifest is made of what the source holds, not of the key that holds the job's id.
  output->set_sha256(Sha256Hex(spec.kind() == v1::INGEST ? spec.sortie().source().path() + source_content : spec.key()));
  output->set_bytes(100);
  if (spec.kind() == v1::INGEST) {
    v1::IngestSummary* ingest = result.mutable_ingest();
    ingest->set_frame_count(18);
    ingest->set_usable_frame_count(18);
    ingest->set_width_px(110);
    ingest->set_height_px(50);
    ingest->mutable_valid_roi()->set_x1(110);
    ingest->mutable_valid_roi()->set_y1(50);
    ingest->add_spans()->set_end(18);
  }
  if (spec.kind() == v1::ALIGN) {
    result.mutable_align()->set_tile_count(kFakeTileCount);
    for (std::uint32_t tile = 0; tile < kFakeTileCount; ++tile) {
      v1::TileInputs* inputs = result.mutable_align()->add_tiles();
      for (std::uint32_t window = 0; window < kFakeWindowCount; ++window) inputs->add_window_ids(window);
    }
  }
  return result;
}

std::vector<Effect> Bench::Step(const Event& event) {
  std::vector<Effect> effects = scheduler.Step(now_ms, event);
  for (const AppendEffect& append : Only<AppendEffect>(effects)) log.push_back(append.event);
  return effects;
}

std::vector<Effect> Bench::Wait(TimeMs ms) {
  now_ms += ms;
  return Step(TickEvent{});
}

std::vector<Effect> Bench::Hello(const std::string& worker_id, std::vector<Attempt> running, std::uint32_t credit,
                                 std::uint64_t memory_bytes_max, const std::string& host) {
  WorkerHelloEvent event;
  event.host = host;
  event.worker_id = worker_id;
  event.credit = credit;
  event.memory_bytes_max = memory_bytes_max;
  event.running = std::move(running);
  return Step(event);
}

std::vector<Effect> Bench::Submit(const std::string& job_id, const std::string& sortie_name, const std::string& user, int priority) {
  return Step(SubmitJobEvent{job_id, FakeSortie(sortie_name), user, priority});
}

std::vector<Effect> Bench::Done(const DispatchEffect& dispatch) {
  TaskDoneEvent event;
  event.worker_id = dispatch.worker_id;
  event.attempt = AttemptOf(dispatch);
  event.result = FakeResult(dispatch.task);
  event.elapsed_ms = 1'000;
  event.peak_memory_bytes = 1'000 + dispatch.task.kind();
  return Step(event);
}

std::vector<Effect> Bench::Fail(const DispatchEffect& dispatch, StatusCode code, const std::string& message,
                                const std::vector<std::string>& bad_artefacts) {
  TaskDoneEvent event;
  event.worker_id = dispatch.worker_id;
  event.attempt = AttemptOf(dispatch);
  event.code = code;
  event.message = message;
  event.bad_artefacts = bad_artefacts;
  return Step(event);
}

int Bench::FailUntilGivenUp(DispatchEffect dispatch, StatusCode code, const std::string& message) {
  for (int times = 1;; ++times) {
    TREM_CHECK_MSG(times < 1'000, "the task is never given up");
    std::vector<Effect> effects = Fail(dispatch, code, message);
    const std::vector<Effect> later = Wait(options.retry_delay_ms_max);
    effects.insert(effects.end(), later.begin(), later.end());
    const std::string key = dispatch.task.key();
    bool again = false;
    for (const DispatchEffect& next : Only<DispatchEffect>(effects)) {
      if (next.task.key() != key) continue;
      dispatch = next;
      again = true;
    }
    if (!again) return times;
  }
}

std::vector<Effect> Bench::Progress(const DispatchEffect& dispatch, double fraction) {
  return Step(ProgressEvent{dispatch.worker_id, AttemptOf(dispatch), fraction});
}

std::vector<DispatchEffect> Bench::RunAll(std::vector<Effect> effects) {
  std::vector<DispatchEffect> done = Only<DispatchEffect>(effects);
  for (std::size_t i = 0; i < done.size(); ++i) {
    TREM_CHECK_MSG(i < 10'000, "the jobs never end");
    const std::vector<DispatchEffect> more = Only<DispatchEffect>(Done(DispatchEffect(done[i])));
    done.insert(done.end(), more.begin(), more.end());
  }
  return done;
}

void Bench::Restart(const std::vector<std::string>& forget) {
  scheduler = Scheduler(options);
  for (const v1::LogEvent& event : log) {
    const bool forgotten =
        event.has_task_committed() && std::find(forget.begin(), forget.end(), event.task_committed().task_key()) != forget.end();
    if (forgotten) continue;
    const trem::Status status = scheduler.Restore(event);
    TREM_CHECK_MSG(status.ok(), status.ToString());
  }
}

void Bench::RestartFromSnapshot() {
  log = scheduler.Snapshot();
  Restart();
}

std::string TitleOf(const DispatchEffect& dispatch) {
  const v1::TaskSpec& task = dispatch.task;
  return TaskTitle(task.kind(), task.kind() == v1::ENHANCE ? task.enhance().window_id() : task.composite().tile_index());
}

Attempt AttemptOf(const DispatchEffect& dispatch) { return {dispatch.task.key(), dispatch.attempt}; }

}  // namespace trem::testing
