#include "tests/bench/score/kept_run.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "coordinator/store/event_store.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/tasks/aligned_scenes.h"

namespace trem::score {
namespace {

constexpr long long kSceneCellsMax = 1LL << 24;
constexpr int kTileSide = 512;

// The exposures of a simulation by their frame's name.
std::map<std::string, const Exposure*> ExposuresByName(const SimulationRecord& record) {
  std::map<std::string, const Exposure*> by_name;
  for (const Exposure& exposure : record.flight.exposures) by_name[FrameName(exposure.index)] = &exposure;
  return by_name;
}

struct TrueFit {
  std::vector<Eigen::Vector2d> x_in_scene;
  std::vector<Eigen::Vector2d> x_in_world;
  double gain_sum = 0.0;
  double offset_sum = 0.0;
  int views = 0;
  std::vector<std::pair<PlanarMap, const Exposure*>> seen;  // scene_from_sensor of each frame.
};

// Where the frames show the places of nodes over the scene, on average of those whose ROI shows them, beside the fitted homography.
CellShifts TrueShifts(const TrueFit& fit, const Homography& world_from_scene, const Roi& raster, const Roi& roi,
                      const SimulationRecord& record) {
  constexpr double kNodeCells = 24.0;
  if (!record.truth.relief) return {};
  CellShifts shifts = CellShifts::Over(Eigen::Vector2d(raster.x0, raster.y0), Eigen::Vector2d(raster.x1 - 1.0, raster.y1 - 1.0), kNodeCells,
                                       Eigen::Vector2d::Zero());
  for (int row = 0; row < shifts.rows; ++row) {
    for (int column = 0; column < shifts.columns; ++column) {
      const Eigen::Vector2d node = shifts.Node(column, row), place = world_from_scene * node;
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      double weight = 0.0;
      for (const auto& [scene_from_sensor, exposure] : fit.seen) {
        const Eigen::Vector2d u =
            PixelFromGround(exposure->camera, record.flight.focal_px, record.options.width_px, record.options.height_px, place);
        const bool inside = u.x() >= roi.x0 && u.y() >= roi.y0 && u.x() < roi.x1 && u.y() < roi.y1;
        const double w = inside ? 1.0 : 1e-3;  // Where no ROI shows the node, all of them tell.
        sum += w * (scene_from_sensor * u - node);
        weight += w;
      }
      shifts.values[static_cast<std::size_t>(row * shifts.columns + column)] = sum / weight;
    }
  }
  return shifts;
}

// Adds one view: the chain's cells and the true ground of the ROI's corners and centre.
Status AddView(const v1::ChainView& view, const Roi& roi, const Exposure& exposure, const SimulationRecord& record, double grey_scale,
               double grey_offset, TrueFit* fit) {
  TREM_ASSIGN_OR_RETURN(const PlanarMap scene_from_sensor, PlanarMapFromProto(view.scene_from_sensor(), "chain.scene_from_sensor"));
  for (const double x : {roi.x0 * 1.0, 0.5 * (roi.x0 + roi.x1 - 1), roi.x1 - 1.0}) {
    for (const double y : {roi.y0 * 1.0, 0.5 * (roi.y0 + roi.y1 - 1), roi.y1 - 1.0}) {
      const Eigen::Vector2d u(x, y);
      fit->x_in_scene.push_back(scene_from_sensor * u);
      fit->x_in_world.push_back(
          GroundFromPixel(exposure.camera, record.flight.focal_px, record.options.width_px, record.options.height_px, u));
    }
  }
  // frame counts = (true gain * truth + true offset) * counts a grey level = grey_offset + grey_scale * (gain * scene + offset).
  const double counts = record.options.bit_depth == 16 ? 256.0 : 1.0;
  fit->gain_sum += grey_scale * view.gain() / (counts * exposure.gain);
  fit->offset_sum += ((grey_offset + grey_scale * view.offset()) / counts - exposure.offset) / exposure.gain;
  ++fit->views;
  fit->seen.emplace_back(scene_from_sensor, &exposure);
  return {};
}

Result<TrueFit> FitOf(const v1::WindowResult& window, const v1::Segment& segment, const v1::EmittedScene& scene, const KeptRun& run,
                      const std::map<std::string, const Exposure*>& exposures, const SimulationRecord& record) {
  TrueFit fit;
  const Roi roi = FromProto(window.roi_in_sensor());
  for (const v1::ChainView& view : segment.chain()) {
    if (view.frame_index() < scene.frame_begin() || view.frame_index() >= scene.frame_end()) continue;
    const std::string& name = run.manifest.frames(static_cast<int>(view.frame_index())).name();
    const auto exposure = exposures.find(name);
    if (exposure == exposures.end()) return InvalidInput("the run's frame '" + name + "' is none of the simulation's");
    TREM_RETURN_IF_ERROR(
        AddView(view, roi, *exposure->second, record, run.manifest.grey_scale(), run.manifest.grey_offset(), &fit));
  }
  return fit;
}

// Takes up what a committed task has put out.
Status Take(const v1::TaskResult& result, KeptRun* run, bool* aligned) {
  for (const v1::ArtefactRef& output : result.outputs()) {
    if (output.name() == "manifest.pb") TREM_RETURN_IF_ERROR(ReadProtoArtefact(run->store, output, &run->manifest));
    if (output.name() == "window.pb") TREM_RETURN_IF_ERROR(ReadProtoArtefact(run->store, output, &run->windows.emplace_back()));
    if (output.name() != "alignment.pb") continue;
    TREM_RETURN_IF_ERROR(ReadProtoArtefact(run->store, output, &run->alignment));
    *aligned = true;
  }
  return {};
}

}  // namespace

Result<KeptRun> ReadKeptRun(const std::filesystem::path& work) {
  if (!std::filesystem::exists(work / "state" / "events.sqlite")) {
    return NotFound("'" + work.string() + "' is no work folder of a run; make one with trem run --keep-work");
  }
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<EventStore> log, EventStore::Open(work / "state"));
  TREM_ASSIGN_OR_RETURN(ArtefactStore store, ArtefactStore::Open(work / "store"));
  KeptRun run{std::move(store), {}, {}, {}};
  std::set<std::string> jobs;
  bool aligned = false;
  const Status read = log->Replay([&](std::int64_t, const v1::LogEvent& event) -> Status {
    if (event.has_job_submitted()) jobs.insert(event.job_submitted().job_id());
    return event.has_task_committed() ? Take(event.task_committed().result(), &run, &aligned) : Status();
  });
  TREM_RETURN_IF_ERROR(read);
  if (jobs.size() != 1 || !aligned) {
    return InvalidInput("'" + work.string() + "' holds " + std::to_string(jobs.size()) + " jobs" + (aligned ? "" : ", none of them aligned") +
                        "; expected one that is finished");
  }
  return run;
}

Result<std::vector<ScenePlacement>> PlaceTruly(const KeptRun& run, const SimulationRecord& record) {
  if (!run.alignment.georeferenced()) return InvalidInput("the run is not georeferenced; its scenes can't be compared with the truth");
  EmittedScenes emitted;
  for (const v1::WindowResult& window : run.windows) TREM_RETURN_IF_ERROR(AddEmittedScenes(window, &emitted));
  std::vector<ArtefactRef> rasters;
  TREM_ASSIGN_OR_RETURN(const std::vector<CompositeScene> scenes, PlacedScenes(run.alignment, emitted, &rasters));
  const std::map<std::string, const Exposure*> exposures = ExposuresByName(record);
  std::map<SceneKey, TrueFit> fits;
  std::map<std::uint32_t, Roi> rois;
  for (const v1::WindowResult& window : run.windows) {
    rois[window.window_id()] = FromProto(window.roi_in_sensor());
    for (const v1::Segment& segment : window.segments()) {
      for (const v1::EmittedScene& scene : segment.scenes()) {
        TREM_ASSIGN_OR_RETURN(fits[SceneKey(window.window_id(), scene.scene_id())],
                              FitOf(window, segment, scene, run, exposures, record));
      }
    }
  }
  std::vector<ScenePlacement> placements;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    const TrueFit& fit = fits.at({scenes[i].window_id, scenes[i].scene_id});
    if (fit.views == 0) continue;
    ScenePlacement placement;
    placement.aligned = scenes[i];
    placement.raster = rasters[i];
    TREM_ASSIGN_OR_RETURN(placement.true_world_from_scene, FitHomography(fit.x_in_scene, fit.x_in_world));
    const Roi& roi = scenes[i].raster_in_scene;
    const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
    placement.true_shifts = TrueShifts(fit, placement.true_world_from_scene, roi, rois.at(scenes[i].window_id), record);
    placement.error_m = scenes[i].world_from_scene * Unshifted(scenes[i].shifts, centre) -
                        placement.true_world_from_scene * Unshifted(placement.true_shifts, centre);
    placement.true_gain = fit.gain_sum / fit.views;
    placement.true_offset = fit.offset_sum / fit.views;
    placements.push_back(placement);
  }
  return placements;
}

Result<Image<float>> ComposeAgain(const KeptRun& run, const std::vector<ScenePlacement>& placements,
                                  const std::function<CompositeScene(const ScenePlacement&)>& change, const CompositeOptions& options) {
  TREM_ASSIGN_OR_RETURN(MosaicGrid grid, FromProto(run.alignment.grid()));
  grid.tile_size = kTileSide;
  std::vector<CompositeScene> scenes;
  for (const ScenePlacement& placement : placements) scenes.push_back(change(placement));
  const SceneReader reader = [&](std::size_t index, const Roi& cells) -> Result<SceneRaster> {
    TREM_ASSIGN_OR_RETURN(const std::filesystem::path path, run.store.Locate(placements[index].raster));
    return ReadSceneRaster(path, kSceneCellsMax, cells);
  };
  Image<float> mosaic(grid.width, grid.height);
  for (int tile = 0; tile < grid.tile_count(); ++tile) {
    const Roi roi = grid.TileRoi(tile);
    TREM_ASSIGN_OR_RETURN(const CompositeTile composed, ComposeTile(grid, roi, scenes, reader, options, [](double) { return true; }));
    for (int y = 0; y < roi.height(); ++y) std::copy_n(composed.median.row(y), roi.width(), mosaic.row(roi.y0 + y) + roi.x0);
  }
  return mosaic;
}

}  // namespace trem::score
