#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/homography.h"
#include "worker/telemetry/telemetry_track.h"

namespace trem {

// What it takes to predict image motion from poses.
struct MotionGeometry {
  int width_px = 0;
  int height_px = 0;
  double ground_elevation_m = 0.0;

  Eigen::Vector2d middle() const { return {0.5 * (width_px - 1), 0.5 * (height_px - 1)}; }
};

// Level ground, metres east and north of the track's first place, from the pixels of a frame at `time_s`. Nothing where the track has no
// pose or the image centre sees no ground.
std::optional<Homography> GroundFromFrameAt(const TelemetryTrack& track, double time_s, const MotionGeometry& geometry);

// A measured registration of a frame to the one before it in the same list; the first of a run has none.
struct MeasuredLink {
  double time_s = 0.0;
  std::optional<Affine> previous_from_current;
};

// How the pictures are turned against what their poses say: files that a viewer turned, a camera that is mounted another way.
struct PictureTurn {
  int quarter_turns = 0;  // -1, 0, 1 or 2, clockwise: measured motion = predicted motion turned by this.
  double degrees = 0.0;   // Median of the pairs.
  int pairs = 0;
};

// Compares directions of measured and predicted motion of the image centre between a link's frame and the one before it, of pairs that move
// by more than 5 % of the width and whose lengths agree within a factor of two. Nothing with fewer than two such pairs, or when fewer than
// 80 % of them lie within 20 degrees of the same quarter turn.
std::optional<PictureTurn> MeasureTurn(const TelemetryTrack& track, const std::vector<MeasuredLink>& links, const MotionGeometry& geometry);

// How far poses wander from what the images show: over runs of up to `frames` linked frames the places of the image centres in the run's
// first frame, once by chained registration and once by the poses, differ by d; rms of d about its mean over each run, per axis.
struct PoseWander {
  double rms_px = 0.0;
  double rms_deg = 0.0;  // Seen from the camera.
  int frames = 0;        // That were compared.
};

// Nothing with fewer than 8 comparable frames. The chain's own drift counts as wander: hundredths of a pixel times the root of a run's
// length.
std::optional<PoseWander> MeasureWander(const TelemetryTrack& track, const std::vector<MeasuredLink>& links, const MotionGeometry& geometry,
                                        int frames = 64);

// Where, in the picture that each link's pose predicts, the axis really points, sensor pixels from the middle: with e the measured less the
// predicted motion into a frame and d the running sum of e over linked frames, d less its mean over the frames of the run at most
// `half_window` away. So the images tell how the camera turned from frame to frame, the poses where it pointed on average. 0 for frames
// that cannot be compared. Axes of the picture are taken to keep their directions within a window.
std::vector<Eigen::Vector2d> PointingErrors(const TelemetryTrack& track, const std::vector<MeasuredLink>& links,
                                            const MotionGeometry& geometry, int half_window = 64);

// `camera` turned, by the shortest rotation, so that its axis goes through what was its pixel middle + `shift_px`. Precondition: hfov_deg.
CameraSample Repointed(const CameraSample& camera, const Eigen::Vector2d& shift_px, const MotionGeometry& geometry);

}  // namespace trem
