#pragma once

#include "mosaic/geometry/planar_map.h"
#include "mosaic/geometry/roi.h"
#include "worker/tre/update_kernels.h"

namespace trem {

// One row of a ROI as a view puts it into the scene plane, in float32 steps: good to 1e-3 cells, for judging pixels, not for estimating.
class ViewRow {
 public:
  ViewRow(const PlanarMap& scene_from_sensor, const Roi& roi, int v) {
    const Eigen::Vector2d sensor(roi.x0, roi.y0 + v);
    const Eigen::Vector2d start = scene_from_sensor.linear * sensor + scene_from_sensor.offset;
    x_ = static_cast<float>(start.x());
    y_ = static_cast<float>(start.y());
    depth_ = static_cast<float>(scene_from_sensor.Depth(sensor));
    step_x_ = static_cast<float>(scene_from_sensor.linear(0, 0));
    step_y_ = static_cast<float>(scene_from_sensor.linear(1, 0));
    step_depth_ = static_cast<float>(scene_from_sensor.perspective.x());
    affine_ = scene_from_sensor.IsAffine();
  }

  // The same steps for a kernel.
  void LayOver(OverlaidRow* row) const {
    row->x = x_;
    row->y = y_;
    row->depth = depth_;
    row->dx = step_x_;
    row->dy = step_y_;
    row->d_depth = step_depth_;
    row->affine = affine_;
  }

  // Scene plane coordinates [cells] of pixel u of the row, u from 0 at the ROI's left column.
  void At(int u, float* x, float* y) const {
    const float i = static_cast<float>(u);
    const float scale = affine_ ? 1.0F : 1.0F / (depth_ + step_depth_ * i);
    *x = (x_ + step_x_ * i) * scale;
    *y = (y_ + step_y_ * i) * scale;
  }

 private:
  float x_ = 0.0F;
  float y_ = 0.0F;
  float depth_ = 1.0F;
  float step_x_ = 0.0F;
  float step_y_ = 0.0F;
  float step_depth_ = 0.0F;
  bool affine_ = true;
};

}  // namespace trem
