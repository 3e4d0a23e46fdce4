#pragma once

#include <vector>

#include "mosaic/geometry/roi.h"
#include "worker/registration/view.h"
#include "worker/tre/frame_input.h"
#include "worker/tre/scene_buffer.h"

namespace trem {

// Gives the cells of `region` (scene plane) that no frame has measured yet a first value: this frame's bicubic one, continued beyond the
// border of its ROI until a frame measures there. Never again after that: cells at the border that are reset with every frame would force
// overshoot on their neighbours. `roi`: where the frame's pixels lie in the sensor. `continued` is scratch memory: the frame with its holes
// continued. Returns a few rectangles of the buffer (not of the scene plane) that hold all cells whose value has changed and not many more.
std::vector<Roi> FillUnseen(const FrameInput& frame, const Roi& roi, const View& view, const Roi& region, SceneBuffer* buffer,
                            Image<float>* continued);

}  // namespace trem
