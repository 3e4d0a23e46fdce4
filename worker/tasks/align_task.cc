// ALIGN: every window's chains and scenes, and telemetry -> alignment.pb, where every scene lies on the mosaic.
#include <algorithm>
#include <array>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <set>
#include <string>
#include <vector>

#include "mosaic/align/align.h"
#include "mosaic/align/level_ties.h"
#include "mosaic/align/output_grid.h"
#include "mosaic/composite/tile_compositor.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/tasks/align_input.h"
#include "worker/tasks/align_notes.h"
#include "worker/tasks/aligned_scenes.h"
#include "worker/tasks/cutline_message.h"
#include "worker/tasks/task.h"
#include "worker/tasks/task_inputs.h"

namespace trem {
namespace {

// Cells of one scene raster read for its features: 128 MiB.
constexpr long long kSceneCellsMax = 1LL << 24;

Status ReadInputs(const v1::TaskSpec& spec, const TaskContext& context, v1::SortieManifest* manifest,
                  std::vector<v1::WindowResult>* windows) {
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef manifest_ref, SingleInput(spec, "manifest.pb"));
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(*context.store, manifest_ref, manifest));
  for (const v1::ArtefactRef& ref : InputsNamed(spec, "window.pb")) {
    if (!context.progress(0.0)) return Cancelled("the alignment was stopped on request");
    TREM_RETURN_IF_ERROR(ReadProtoArtefact(*context.store, ref, &windows->emplace_back()));
  }
  std::sort(windows->begin(), windows->end(),
            [](const v1::WindowResult& a, const v1::WindowResult& b) { return a.window_id() < b.window_id(); });
  return {};
}

align::FeatureSource FeaturesFromStore(const ArtefactStore& store, const AlignTaskInput& input) {
  // What the store has to fetch comes one after the other.
  return
      [&store, &input, mutex = std::make_shared<std::mutex>()](const align::AlignGraph& graph, int index) -> Result<align::SceneFeatures> {
        const align::SceneNode& node = graph.scenes[static_cast<std::size_t>(index)];
        const ArtefactRef& ref = input.rasters.at({node.window_id, node.scene.scene_id});
        std::unique_lock lock(*mutex);
        TREM_RETURN_IF_ERROR(store.Verify(ref));
        TREM_ASSIGN_OR_RETURN(const std::filesystem::path path, store.Locate(ref));
        lock.unlock();
        TREM_ASSIGN_OR_RETURN(const SceneRaster raster, ReadSceneRaster(path, kSceneCellsMax));
        const Roi& roi = node.scene.roi_in_scene;
        if (raster.intensity.width() != roi.width() || raster.intensity.height() != roi.height()) {
          return Corrupt("scene " + std::to_string(node.scene.scene_id) + " of window " + std::to_string(node.window_id) +
                         " is a raster of " + std::to_string(raster.intensity.width()) + " x " + std::to_string(raster.intensity.height()) +
                         " cells; expected " + ToString(roi));
        }
        align::SceneFeatures features = align::ExtractFeatures(raster.intensity, raster.information, roi, graph.input.ratio, {});
        features.levels = align::MeanLevels(raster.intensity, raster.information, roi, graph.input.ratio);
        return features;
      };
}

// The sortie's cutline in the mosaic's CRS; without rings when it has none.
Result<PolygonRings> CutlineOf(const v1::SortieManifest& manifest, const AlignTaskInput& input, bool georeferenced) {
  PolygonRings polygons;
  if (manifest.cutline().rings().empty()) return polygons;
  if (!georeferenced) return InvalidInput("mosaic.cutline_path needs telemetry that places the mosaic; leave it out, or give telemetry");
  polygons = PolygonsFromProto(manifest.cutline());
  TREM_ASSIGN_OR_RETURN(polygons, Reproject(polygons, input.crs_wkt));
  return polygons;
}

std::array<double, 4> RectangleOf(const PolygonRings& polygons) {
  Eigen::Vector2d low = polygons.rings[0][0], high = low;
  for (const std::vector<Eigen::Vector2d>& ring : polygons.rings) {
    for (const Eigen::Vector2d& point : ring) {
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  }
  return {low.x(), low.y(), high.x(), high.y()};
}

Result<MosaicGrid> GridOf(const v1::Sortie& sortie, const AlignTaskInput& input, const align::AlignSolution& solution,
                          const Homography& map_from_world, const PolygonRings& cutline) {
  std::vector<align::SceneFootprint> footprints;
  for (const align::AlignedScene& scene : solution.scenes) {
    align::SceneFootprint footprint{scene.window_id, scene.scene_id, align::RoiCorners(scene.roi_in_scene)};
    for (Eigen::Vector2d& corner : footprint.corners) {
      const Eigen::Vector2d in_scene = corner;
      corner = map_from_world * (scene.world_from_scene * Unshifted(scene.shifts, in_scene));
    }
    footprints.push_back(footprint);
  }
  std::vector<Homography> frames;
  for (const align::AlignedFrame& frame : solution.frames) frames.push_back(map_from_world * frame.world_from_sensor);
  align::GridOptions options;
  options.crs_wkt = solution.georeferenced ? input.crs_wkt : LocalPixelCrsWkt();
  options.gsd = sortie.mosaic().gsd();
  if (sortie.mosaic().has_bounds()) {
    const v1::Bounds& bounds = sortie.mosaic().bounds();
    options.bounds = {{bounds.x_min(), bounds.y_min(), bounds.x_max(), bounds.y_max()}};
  }
  if (!cutline.rings.empty()) options.clip = RectangleOf(cutline);
  if (sortie.mosaic().tile_px() > 0) options.tile_size = static_cast<int>(sortie.mosaic().tile_px());
  return align::ChooseGrid(footprints, align::SensorGsd(frames, input.align.width_px, input.align.height_px), input.align.ratio, options);
}

v1::Alignment ToMessage(const align::AlignSolution& solution, const MosaicGrid& grid, const Homography& map_from_world, double scale) {
  v1::Alignment alignment;
  *alignment.mutable_grid() = ToProto(grid);
  for (const align::AlignedScene& scene : solution.scenes) {
    v1::AlignedScene* const out = alignment.add_scenes();
    out->set_window_id(scene.window_id);
    out->set_scene_id(scene.scene_id);
    out->set_piece(static_cast<std::uint32_t>(scene.piece));
    Homography map_from_scene = map_from_world * scene.world_from_scene;
    const Roi& roi = scene.roi_in_scene;
    map_from_scene.matrix /= map_from_scene.Depth({0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)});
    ToProto(map_from_scene, out->mutable_world_from_scene());
    if (!scene.shifts.empty()) ToProto(scene.shifts, out->mutable_relief());
    if (!scene.shade.empty()) ToProto(scene.shade, out->mutable_shade());
    out->set_gain(scene.balanced_from_scene.gain);
    out->set_offset(scene.balanced_from_scene.offset);
    out->set_position_sigma(scene.position_sigma * scale);
  }
  for (const align::AlignedFrame& frame : solution.frames) {
    v1::AlignedFrame* const out = alignment.add_frames();
    out->set_frame_index(frame.frame);
    out->set_piece(static_cast<std::uint32_t>(frame.piece));
    ToProto(map_from_world * frame.world_from_sensor, out->mutable_world_from_sensor());
    out->set_gain(frame.frame_from_balanced.gain);
    out->set_offset(frame.frame_from_balanced.offset);
    out->set_residual_px(frame.residual_px);
  }
  alignment.set_piece_count(static_cast<std::uint32_t>(solution.piece_count));
  alignment.set_georeferenced(solution.georeferenced);
  alignment.set_gauge(solution.gauge);
  alignment.set_tie_rms_px(solution.tie_rms_px);
  const auto fit = [](const align::ControlFit& from, v1::ControlFit* out) {
    out->set_point_count(static_cast<std::uint32_t>(from.point_count));
    out->set_rmse_m(from.rmse_m);
    out->set_ce90_m(from.ce90_m);
  };
  if (solution.control.constraints.point_count > 0) fit(solution.control.constraints, alignment.mutable_control_constraints());
  if (solution.control.checks.point_count > 0) fit(solution.control.checks, alignment.mutable_control_checks());
  for (const align::AlignedControl& control : solution.control.observations) {
    v1::ControlError* const error = alignment.add_control_errors();
    error->set_name(control.name);
    error->set_frame_index(control.frame);
    error->set_held_out(control.held_out);
    error->set_outlier(control.outlier);
    error->set_east_m(control.error_m.x());
    error->set_north_m(control.error_m.y());
  }
  return alignment;
}

// What the COMPOSITE task of each tile has to read.
Status AddTileInputs(const MosaicGrid& grid, const v1::Alignment& alignment, const std::vector<v1::WindowResult>& windows,
                     v1::AlignSummary* summary) {
  EmittedScenes emitted;
  for (const v1::WindowResult& window : windows) TREM_RETURN_IF_ERROR(AddEmittedScenes(window, &emitted));
  std::vector<ArtefactRef> rasters;
  TREM_ASSIGN_OR_RETURN(const std::vector<CompositeScene> scenes, PlacedScenes(alignment, emitted, &rasters));
  TREM_ASSIGN_OR_RETURN(const std::vector<std::vector<std::size_t>> tiles, ScenesByTile(grid, scenes));
  for (const std::vector<std::size_t>& tile : tiles) {
    std::set<std::uint32_t> window_ids;
    for (const std::size_t index : tile) window_ids.insert(scenes[index].window_id);
    summary->add_tiles()->mutable_window_ids()->Add(window_ids.begin(), window_ids.end());
  }
  return {};
}

}  // namespace

Result<v1::TaskResult> RunAlignTask(const v1::TaskSpec& spec, const TaskContext& context) {
  cv::setNumThreads(1);
  v1::SortieManifest manifest;
  std::vector<v1::WindowResult> windows;
  TREM_RETURN_IF_ERROR(ReadInputs(spec, context, &manifest, &windows));
  TREM_ASSIGN_OR_RETURN(const AlignTaskInput input, MakeAlignInput(spec.sortie(), manifest, windows));
  const FrameCensus census = CountFrames(manifest, windows);
  if (input.rasters.empty()) return Failed(NothingEnhancedText(census));

  align::AlignOptions options;
  options.threads = context.threads;
  Result<align::AlignSolution> solved = align::Align(input.align, options, FeaturesFromStore(*context.store, input), context.progress);
  if (!solved.ok()) return solved.status();
  const align::AlignSolution& solution = *solved;
  const Homography map_from_world = solution.georeferenced ? input.map_from_working : Homography{};
  TREM_ASSIGN_OR_RETURN(PolygonRings cutline, CutlineOf(manifest, input, solution.georeferenced));
  TREM_ASSIGN_OR_RETURN(const MosaicGrid grid, GridOf(spec.sortie(), input, solution, map_from_world, cutline));
  v1::Alignment alignment = ToMessage(solution, grid, map_from_world, solution.georeferenced ? input.scale : 1.0);

  cutline.crs_wkt.clear();
  if (!cutline.rings.empty()) ToProto(cutline, alignment.mutable_cutline());

  v1::TaskResult result;
  for (const v1::Note& note : AlignNotes(spec.sortie(), manifest, census, input, solution)) {
    *alignment.add_notes() = note;
    *result.add_notes() = note;
  }
  TREM_ASSIGN_OR_RETURN(*result.add_outputs(), PutProtoArtefact(*context.store, "alignment.pb", alignment));
  result.mutable_align()->set_tile_count(static_cast<std::uint32_t>(grid.tile_count()));
  result.mutable_align()->set_width_px(static_cast<std::uint32_t>(grid.width));
  result.mutable_align()->set_height_px(static_cast<std::uint32_t>(grid.height));
  TREM_RETURN_IF_ERROR(AddTileInputs(grid, alignment, windows, result.mutable_align()));
  return result;
}

}  // namespace trem
