#include "worker/tasks/aligned_scenes.h"

#include <cmath>
#include <string>

#include "proto/codec/convert.h"

namespace trem {
namespace {

std::string Name(const SceneKey& key) { return "scene " + std::to_string(key.second) + " of window " + std::to_string(key.first); }

}  // namespace

Status AddEmittedScenes(const v1::WindowResult& window, EmittedScenes* emitted) {
  for (const v1::Segment& segment : window.segments()) {
    for (const v1::EmittedScene& scene : segment.scenes()) {
      const SceneKey key{window.window_id(), scene.scene_id()};
      if (!emitted->emplace(key, scene).second) return Corrupt(Name(key) + " was emitted twice");
    }
  }
  return {};
}

Result<std::vector<CompositeScene>> PlacedScenes(const v1::Alignment& alignment, const EmittedScenes& emitted,
                                                 std::vector<ArtefactRef>* rasters) {
  std::vector<CompositeScene> scenes;
  scenes.reserve(static_cast<std::size_t>(alignment.scenes_size()));
  for (const v1::AlignedScene& aligned : alignment.scenes()) {
    const SceneKey key{aligned.window_id(), aligned.scene_id()};
    const auto found = emitted.find(key);
    if (found == emitted.end()) return Corrupt("alignment.pb places " + Name(key) + ", which no window.pb lists");
    CompositeScene scene;
    scene.window_id = aligned.window_id();
    scene.scene_id = aligned.scene_id();
    TREM_ASSIGN_OR_RETURN(scene.world_from_scene, HomographyFromProto(aligned.world_from_scene(), "AlignedScene.world_from_scene"));
    scene.raster_in_scene = FromProto(found->second.roi_in_scene());
    TREM_ASSIGN_OR_RETURN(scene.shifts, CellShiftsFromProto(aligned.relief(), "AlignedScene.relief"));
    TREM_ASSIGN_OR_RETURN(scene.shade, CellGridFromProto(aligned.shade(), "AlignedScene.shade"));
    scene.gain = aligned.gain();
    scene.offset = aligned.offset();
    scene.position_sigma = aligned.position_sigma();
    if (!(scene.gain > 0.0) || !std::isfinite(scene.gain) || !std::isfinite(scene.offset)) {
      return Corrupt("alignment.pb gives " + Name(key) + " the gain " + std::to_string(scene.gain) + " and offset " +
                     std::to_string(scene.offset) + "; expected a positive gain and finite numbers");
    }
    scenes.push_back(scene);
    rasters->push_back(FromProto(found->second.raster()));
  }
  return scenes;
}

}  // namespace trem
