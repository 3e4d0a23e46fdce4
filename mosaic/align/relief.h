#pragma once

#include "mosaic/align/align_state.h"

namespace trem::align {

// Over ground that is no plane a scene is no homography of the map. What remains of each scene's places without it is found from the ground
// and the cameras, and kept in SceneState::shifts: at nodes over the scene
//
//   shift(c) = mean over its frames t of  v_t(camera_t(x, z(x))) - v_t(camera_t(x, plane(x))),   x = world_from_scene * c
//
// with v_t the chain's view, z the ground's elevation and `plane` the plane that fits it best under the scene. So the homography stands for
// that plane, and errors of the cameras' places, which shift both terms alike, stay out. Frames whose ROI does not reach the node count
// little. Scenes that no camera sees, and all of them over level ground, have none.
//
// kPlaces, after the last solve, is where the frames show the places, all told:
//
//   shift(c) = mean over t of  v_t(camera_t(x, z(x))) - c
//
// which has, besides, what affine views leave of the perspective of a slope.
// kRelief finds AlignState::tie_relief_px besides. An affine view is drawn to what its texture shows of the hills that it cannot follow: by
// up to r, the rms of what is left of the frame's shifts less the scene's beside an affine map. The texture is the scene's, so its n ties
// err alike, and n of them say no more than one: r sqrt(n) on each.
enum class Shifts { kRelief, kPlaces };
void UpdateShifts(const AlignGraph& graph, Shifts kind, AlignState& state);

}  // namespace trem::align
