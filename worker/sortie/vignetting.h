#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/roi.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What a lens takes of the light towards the corners of the image: a factor on the grey levels at r half diagonals from its centre,
//
//   V(r) = exp(second r^2 + fourth r^4)
struct RadialVignetting {
  double second = 0.0;
  double fourth = 0.0;

  double At(double r2) const;
  double Corner() const { return At(1.0); }
};

struct VignettingEstimate {
  RadialVignetting vignetting;
  double corner_error = 0.0;  // Standard error of log V at the corners.
  std::size_t pair_count = 0;

  // Whether the frames leave no doubt that there is one, and one that matters.
  bool Seen() const;
};

// Estimates vignetting from ground that frames show at different places of the image: what is brighter in the middle than it was in the
// corner was darkened there. For patches of ground (about a sixteenth of the image a side) in two frames,
//
//   log level_a - log level_b = log V(r_a) - log V(r_b) + gain + offset / level + noise
//
// with gain and offset of each pair of frames free, so that exposure does not matter. Robust least squares over all pairs; the error is
// that of pairs as clusters. Movement along one straight line is enough, because V is round. A ramp across the image would look like a
// change of exposure and is not looked for.
//
// Frames are thinned to key frames a twelfth of the image apart, and these to at most 128, evenly over the sortie: memory is bounded.
class VignettingFinder {
 public:
  // `valid_roi`: the image without borders. `level_max`: from which grey level pixels are not used (saturated).
  VignettingFinder(int width_px, int height_px, const Roi& valid_roi, double level_max);

  // Takes up the next frame: `reduced` as of ReduceFrame, grey levels above black; the motion as FrameMotion::Link, nothing after a cut.
  void Add(const Image<float>& reduced, const std::optional<Affine>& previous_from_current);
  // Nothing when too few pairs of frames show the same ground at different places.
  std::optional<VignettingEstimate> Find() const;

 private:
  // Mean levels of overlapping patches; NaN where one can't be used.
  struct Key {
    Image<float> patches;
    Affine key_from_current;
  };
  struct Observation {
    float log_ratio;
    float inverse_level;  // Relative to the pair's mean.
    float second;         // Differences of r^2 and r^4.
    float fourth;
  };
  struct Pair {
    std::size_t group = 0;  // The later key frame.
    std::vector<Observation> places;
  };
  class Fit;

  Image<float> PatchesOf(const Image<float>& reduced) const;
  Eigen::Vector2d PixelOfPatch(int column, int row) const;
  double RadiusSquared(const Eigen::Vector2d& u) const;
  std::optional<Pair> Compare(const Image<float>& current, const Key& key) const;

  Eigen::Vector2d size_px_;
  Roi valid_roi_;
  double level_max_;
  Eigen::Vector2d block_px_ = Eigen::Vector2d::Ones();  // Sensor pixels of a block; a patch is 3 x 3 of them.
  std::deque<Key> keys_;
  std::vector<Pair> pairs_;
  std::size_t key_count_ = 0;
  std::size_t group_stride_ = 1;
};

RadialVignetting FromProto(const v1::VignettingMessage& message);

// 1 / V for every pixel of a sensor; empty when none was found.
Image<float> BrighteningOf(const v1::SensorManifest& sensor, int width_px, int height_px);

// Multiplies a whole frame [grey levels of the source] by it; nothing when it is empty. Precondition: of one size.
void Brighten(const Image<float>& brightening, Image<float>* frame);

}  // namespace trem
