#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "mosaic/align/frames_and_scenes.h"

namespace trem::align {

// A simulated sortie: true cameras over flat ground, and the chains that windows over it would report.
struct SyntheticOptions {
  std::uint64_t seed = 1;
  int frame_count = 40;
  double pitch_deg = -90.0;
  double roll_jitter_deg = 0.2;
  double speed_m = 2.0;         // A frame.
  int leg_frames = 0;           // > 0: lawnmower legs of that many frames, each half a footprint beside the last.
  double view_sigma_px = 0.02;  // Noise of each chain view's corners.
  double hfov_deg = 8.0;
  double slope = 0.0;        // Of the ground, which rises to the north-east.
  double hills_m = 0.0;      // Amplitude of waves of the ground, 60 m long, along and across the flight.
  double k1 = 0.0;           // Radial distortion of the lens; affine views only.
  double focal_error = 0.0;  // Telemetry's focal length = (1 + this) * true one.
  bool projective_views = false;  // Chain views are the homographies; else the affine maps that fit best over the ROI.
  // Telemetry's errors.
  double position_bias_m = 0.0;  // Sigma of the shared error.
  double position_white_m = 0.0;
  double attitude_bias_deg = 0.0;
  double attitude_white_deg = 0.0;
  bool telemetry = true;
  int gap_after_frame = -1;  // No window straddles this frame: a gap.
  double gain_sigma = 0.0;   // Log gain of frames; scenes take the gain of their segment's first frame.
  double offset_sigma = 0.0;
};

struct SyntheticSortie {
  AlignInput input;
  std::vector<Homography> world_from_sensor;     // Truth, by frame.
  std::vector<double> frame_gain, frame_offset;  // frame = gain * ground + offset.
  // Truth, parallel to input.segments.
  std::vector<Homography> world_from_scene;
  std::vector<double> scene_gain, scene_offset;
  double gsd_m = 0.0;
  double focal_px = 0.0;
  // Over hills, where scenes show what the first frame of their window sees: the true cameras, and that frame of each segment.
  std::vector<CameraPose> poses;
  std::vector<int> first_frame;

  // Where the true lens shows what a pinhole would show at `u`, and back.
  Eigen::Vector2d Distorted(const Eigen::Vector2d& u, double k1) const;
  Eigen::Vector2d Undistorted(const Eigen::Vector2d& u, double k1) const;
  // Hills: the place on the ground that cell `c` of a segment's scenes shows.
  Eigen::Vector2d PlaceOfCell(std::size_t segment, const Eigen::Vector2d& c) const;
};

// Observations of a point of the true ground, in the frames among `frames` that see it, `sigma_px` off along each axis.
std::vector<ControlObservation> ObserveControl(const SyntheticOptions& options, const SyntheticSortie& sortie, const std::string& name,
                                               const Eigen::Vector2d& place, double sigma_px);

// Four points in the corners of what the flight sees, 0.2 px off.
std::vector<ControlObservation> FourPoints(const SyntheticOptions& options, const SyntheticSortie& sortie);

SyntheticSortie MakeSortie(const SyntheticOptions& options);

}  // namespace trem::align
