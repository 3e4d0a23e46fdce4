// Goal: task specs carry the inputs the contract names, and their keys and seeds change exactly when the task does. Method: specs of a
// small job made by hand, compared field by field; keys compared after single changes.
#include "coordinator/planning/task_plan.h"

#include <gtest/gtest.h>

#include <set>

#include "coordinator/planning/memory_estimate.h"
#include "mosaic/base/digest.h"

namespace trem {
namespace {

v1::ArtefactRef MakeRef(const std::string& name, const std::string& content) {
  v1::ArtefactRef ref;
  ref.set_name(name);
  ref.set_sha256(Sha256Hex(content));
  ref.set_bytes(content.size());
  return ref;
}

JobInputs MakeInputs() {
  JobInputs inputs;
  inputs.job_id = "job";
  inputs.sortie.mutable_source()->set_path("/data/leg");
  inputs.sortie.mutable_tre()->set_ratio(3);
  inputs.sortie.mutable_mosaic()->set_tile_px(512);
  inputs.sortie.set_seed(7);
  inputs.ingest.set_width_px(256);
  inputs.ingest.set_height_px(200);
  inputs.ingest.set_frame_count(60);
  inputs.manifest = MakeRef("manifest.pb", "manifest");
  inputs.windows = {{0, {0, 0, 100, 100}, 0, 40}, {1, {80, 0, 180, 100}, 0, 40}};
  inputs.window_pbs = {MakeRef("window.pb", "a"), MakeRef("window.pb", "b")};
  inputs.window_pb_bytes = 2;
  inputs.align.set_tile_count(3);
  inputs.align.add_tiles()->add_window_ids(0);
  inputs.align.add_tiles();
  v1::TileInputs* both = inputs.align.add_tiles();
  both->add_window_ids(0);
  both->add_window_ids(1);
  inputs.alignment = MakeRef("alignment.pb", "alignment");
  inputs.tiles = {MakeRef("tile.tif", "t0"), MakeRef("tile.tif", "t1"), MakeRef("tile.tif", "t2")};
  return inputs;
}

std::vector<std::string> InputDigests(const v1::TaskSpec& spec) {
  std::vector<std::string> digests;
  for (const v1::ArtefactRef& input : spec.inputs()) digests.push_back(input.sha256());
  return digests;
}

TEST(TaskPlanTest, ListsInputsInTheOrderOfTheContract) {
  const JobInputs inputs = MakeInputs();
  const std::string manifest = inputs.manifest.sha256();
  const std::string alignment = inputs.alignment.sha256();
  const std::string a = inputs.window_pbs[0].sha256();
  const std::string b = inputs.window_pbs[1].sha256();
  using Digests = std::vector<std::string>;
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::INGEST, 0)), Digests{});
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::ENHANCE, 1)), Digests{manifest});
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::ALIGN, 0)), (Digests{manifest, a, b}));
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::COMPOSITE, 0)), (Digests{alignment, a}));
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::COMPOSITE, 1)), (Digests{alignment}));
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::COMPOSITE, 2)), (Digests{alignment, a, b}));
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::EXPORT, 0)),
            (Digests{alignment, manifest, a, b, inputs.tiles[0].sha256(), inputs.tiles[1].sha256(), inputs.tiles[2].sha256()}));
}

TEST(TaskPlanTest, CarriesWindowAndTile) {
  const JobInputs inputs = MakeInputs();
  const v1::TaskSpec enhance = PlanTask(inputs, v1::ENHANCE, 1);
  EXPECT_EQ(enhance.enhance().window_id(), 1U);
  EXPECT_EQ(enhance.enhance().roi_in_sensor().x0(), 80);
  EXPECT_EQ(enhance.enhance().roi_in_sensor().x1(), 180);
  EXPECT_EQ(enhance.enhance().frame_end(), 40U);
  EXPECT_EQ(PlanTask(inputs, v1::COMPOSITE, 2).composite().tile_index(), 2U);
}

TEST(TaskPlanTest, GivesEveryTaskOfAJobItsOwnKeyAndSeed) {
  const JobInputs inputs = MakeInputs();
  std::set<std::string> keys;
  std::set<std::uint64_t> seeds;
  const std::vector<std::pair<v1::TaskKind, std::uint32_t>> tasks = {{v1::INGEST, 0},    {v1::ENHANCE, 0},   {v1::ENHANCE, 1},
                                                                     {v1::ALIGN, 0},     {v1::COMPOSITE, 0}, {v1::COMPOSITE, 1},
                                                                     {v1::COMPOSITE, 2}, {v1::EXPORT, 0}};
  for (const auto& [kind, index] : tasks) {
    const v1::TaskSpec spec = PlanTask(inputs, kind, index);
    EXPECT_TRUE(IsSha256Hex(spec.key()));
    EXPECT_EQ(spec.key(), TaskKey(spec, inputs.job_id));
    EXPECT_GT(spec.memory_bytes(), kProcessBytes);
    keys.insert(spec.key());
    seeds.insert(spec.seed());
  }
  EXPECT_EQ(keys.size(), tasks.size());
  EXPECT_EQ(seeds.size(), tasks.size());
}

TEST(TaskPlanTest, ChangesTheKeyWithParametersAndInputsOnly) {
  const JobInputs inputs = MakeInputs();
  const std::string key = PlanTask(inputs, v1::ENHANCE, 0).key();

  JobInputs other_job = inputs;
  other_job.job_id = "other";
  EXPECT_EQ(PlanTask(other_job, v1::ENHANCE, 0).key(), key) << "jobs must share equal tasks";
  EXPECT_NE(PlanTask(other_job, v1::INGEST, 0).key(), PlanTask(inputs, v1::INGEST, 0).key()) << "a source may have changed between jobs";

  JobInputs other_seed = inputs;
  other_seed.sortie.set_seed(8);
  EXPECT_NE(PlanTask(other_seed, v1::ENHANCE, 0).key(), key);
  JobInputs other_manifest = inputs;
  other_manifest.manifest = MakeRef("manifest.pb", "another");
  EXPECT_NE(PlanTask(other_manifest, v1::ENHANCE, 0).key(), key);
  JobInputs other_roi = inputs;
  other_roi.windows[0].roi_in_sensor.x1 = 99;
  EXPECT_NE(PlanTask(other_roi, v1::ENHANCE, 0).key(), key);
}

// What the windows of a recording are made of decides their keys, nothing else that the sortie says.
TEST(TaskPlanTest, AnotherMosaicOrOneMoreRecordingLeavesTheWindowsAsTheyAre) {
  JobInputs inputs = MakeInputs();
  inputs.recordings = {MakeRef("recording.pb", "first")};
  inputs.ingest.add_recording_begins(0);
  const std::string key = PlanTask(inputs, v1::ENHANCE, 0).key();
  JobInputs other = inputs;
  other.sortie.mutable_mosaic()->set_gsd(0.5);
  other.sortie.mutable_control()->set_path("/data/gcp.csv");
  other.sortie.mutable_telemetry()->set_dem_path("/data/dem.tif");
  other.sortie.add_more()->mutable_source()->set_path("/data/second");
  other.manifest = MakeRef("manifest.pb", "of both");
  other.recordings.push_back(MakeRef("recording.pb", "second"));
  other.ingest.add_recording_begins(60);
  other.ingest.set_frame_count(120);
  other.windows.push_back({2, {0, 0, 100, 100}, 60, 100});
  other.window_pbs.push_back(MakeRef("window.pb", "c"));
  EXPECT_EQ(PlanTask(other, v1::ENHANCE, 0).key(), key);
  const v1::TaskSpec second = PlanTask(other, v1::ENHANCE, 2);
  EXPECT_EQ(second.inputs(0).sha256(), other.recordings[1].sha256());
  EXPECT_EQ(second.sortie().source().path(), "/data/second") << "a worker that fetches its sources must know which";
  EXPECT_NE(PlanTask(other, v1::ALIGN, 0).key(), PlanTask(inputs, v1::ALIGN, 0).key());
  inputs.sortie.mutable_tre()->set_ratio(2);
  EXPECT_NE(PlanTask(inputs, v1::ENHANCE, 0).key(), key);
}

TEST(TaskPlanTest, PlansKeyAndMemoryWithoutTheWindowsAsWithThem) {
  JobInputs inputs = MakeInputs();
  for (const std::string& digest : {std::string(), WindowsDigest(inputs.window_pbs)}) {
    inputs.window_pbs_digest = digest;
    for (const v1::TaskKind kind : {v1::INGEST, v1::ENHANCE, v1::ALIGN, v1::COMPOSITE, v1::EXPORT}) {
      const v1::TaskSpec spec = PlanTask(inputs, kind, 0);
      EXPECT_EQ(PlanTaskKey(inputs, kind, 0).key, spec.key());
      EXPECT_EQ(PlanTaskKey(inputs, kind, 0).memory_bytes, spec.memory_bytes());
    }
  }
}

TEST(TaskPlanTest, ChangesTheKeysOfWhatReadsWindowsWhenOneOfThemChangesOrIsAHole) {
  const JobInputs inputs = MakeInputs();
  JobInputs other = inputs;
  other.window_pbs[1] = MakeRef("window.pb", "c");
  JobInputs hole = inputs;
  hole.window_pbs[1].Clear();
  JobInputs swapped = inputs;
  std::swap(swapped.window_pbs[0], swapped.window_pbs[1]);
  for (const v1::TaskKind kind : {v1::ALIGN, v1::COMPOSITE, v1::EXPORT}) {
    std::set<std::string> keys;
    for (const JobInputs* job : std::initializer_list<const JobInputs*>{&inputs, &other, &hole, &swapped}) {
      keys.insert(PlanTaskKey(*job, kind, kind == v1::COMPOSITE ? 2 : 0).key);  // Both windows reach tile 2.
    }
    EXPECT_EQ(keys.size(), 4U) << v1::TaskKind_Name(kind);
  }
  // Window 1 does not reach tile 0.
  EXPECT_EQ(PlanTaskKey(inputs, v1::COMPOSITE, 0).key, PlanTaskKey(other, v1::COMPOSITE, 0).key);
}

TEST(TaskPlanTest, LeavesHolesOutAndNamesTheMissingTiles) {
  JobInputs inputs = MakeInputs();
  inputs.window_pbs[0].Clear();
  inputs.tiles[1].Clear();
  inputs.holes.emplace_back().set_subject("COMPOSITE tile 1");
  const std::string b = inputs.window_pbs[1].sha256();
  EXPECT_EQ(InputDigests(PlanTask(inputs, v1::ALIGN, 0)), (std::vector<std::string>{inputs.manifest.sha256(), b}));
  const v1::TaskSpec task = PlanTask(inputs, v1::EXPORT, 0);
  EXPECT_EQ(InputDigests(task), (std::vector<std::string>{inputs.alignment.sha256(), inputs.manifest.sha256(), b, inputs.tiles[0].sha256(),
                                                          inputs.tiles[2].sha256()}));
  ASSERT_EQ(task.export_params().missing_tiles_size(), 1);
  EXPECT_EQ(task.export_params().missing_tiles(0), 1U);
  EXPECT_EQ(task.export_params().holes(0).subject(), "COMPOSITE tile 1");
}

TEST(TaskPlanTest, BoundsTheMemoryOfAnEnhanceTaskByItsFormula) {
  const JobInputs inputs = MakeInputs();
  const std::uint64_t frames = inputs.windows[0].frame_end - inputs.windows[0].frame_begin;
  const std::uint64_t exact = kProcessBytes + 100ULL * 100 * 9 * 2 * 120 + 100ULL * 100 * frames * 16 + 256ULL * 200 * 40;
  const std::uint64_t bytes = EnhanceMemoryBytes(inputs.sortie, 256, 200, inputs.windows[0]);
  EXPECT_GE(bytes, exact);
  EXPECT_LT(bytes, exact + (1U << 20));
  EXPECT_EQ(bytes % (1U << 20), 0U);
}

TEST(TaskPlanTest, RefusesResultsThatLackWhatLaterStagesNeed) {
  v1::TaskResult result;
  EXPECT_FALSE(CheckTaskResult(v1::ENHANCE, result).ok());
  *result.add_outputs() = MakeRef("window.pb", "w");
  EXPECT_TRUE(CheckTaskResult(v1::ENHANCE, result).ok());
  EXPECT_FALSE(CheckTaskResult(v1::COMPOSITE, result).ok()) << "a window is no tile";
  result.mutable_outputs(0)->set_sha256("../../etc/passwd");
  EXPECT_FALSE(CheckTaskResult(v1::ENHANCE, result).ok());
  result.mutable_outputs(0)->CopyFrom(MakeRef("manifest.pb", "m"));
  EXPECT_FALSE(CheckTaskResult(v1::INGEST, result).ok()) << "the planner needs the summary";
  result.mutable_ingest()->set_frame_count(1);
  EXPECT_TRUE(CheckTaskResult(v1::INGEST, result).ok());
  result.mutable_outputs(0)->CopyFrom(MakeRef("alignment.pb", "m"));
  result.mutable_align()->set_tile_count(0);
  EXPECT_FALSE(CheckTaskResult(v1::ALIGN, result).ok());
  result.mutable_align()->set_tile_count(1);
  EXPECT_FALSE(CheckTaskResult(v1::ALIGN, result).ok());
  result.mutable_align()->add_tiles();
  EXPECT_TRUE(CheckTaskResult(v1::ALIGN, result).ok());
}

}  // namespace
}  // namespace trem
