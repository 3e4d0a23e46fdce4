#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/roi.h"
#include "worker/tre/mapping_engine.h"

namespace trem::testing {

// How the camera of a sequence moves.
enum class CameraMotion {
  kPath,   // Along x at `speed_px` a frame on a smooth path with a swing of rotation and zoom.
  kDwell,  // Keeps looking at one place: a random walk about it of 0.5 px a step and 1.1 px in all (each axis), 0.002 in rotation, zoom
           // and shear, and a slow drift of `speed_px` a frame. The first frame's pixels fall on the truth's cells.
};

// A sequence of frames with known truth for tests of the engine: a camera over a flat picture.
struct SequenceOptions {
  CameraMotion motion = CameraMotion::kPath;
  int cells_per_pixel = 3;  // Of the truth. More for content finer than what three cells can carry.
  int frame_count = 60;
  int roi_px = 61;           // Side of the frames, which are the ROI.
  double speed_px = 0.8;     // Motion a frame.
  double turn_rad = 0.0;     // Steady rotation a frame, on top of a small swing.
  double noise_sigma = 2.0;  // Grey levels.
  double psf_sigma_px = 0.55;
  double fill_factor = 0.9;
  double gain_swing = 0.05;  // Amplitude of a slow drift.
  double offset_swing = 4.0;
  double motion_sigma_px = 0.3;  // Error of the whole-image motion that the engine is told, each axis.
  std::uint64_t seed = 1;
};

struct RenderedSequence {
  Image<float> truth;
  Roi roi;
  std::vector<FrameInput> frames;
  std::vector<Affine> truth_from_sensor;  // One a frame.
  std::vector<double> gains;
  std::vector<double> offsets;

  // The scene plane of a segment that begins at frame `first` is cell = 3 * sensor there.
  Affine TruthFromScene(int first, int ratio = 3) const;
};

// Fields with roofs, roads and bars of sharp edges, and a little texture of one cell; 0..255.
Image<float> ProceduralTruth(int width, int height, std::uint64_t seed);
// `image` filtered by [1 2 1] / 4 in each axis: what a scene of the truth's sampling can carry. The border of one pixel is 0.
Image<float> Filtered121(const Image<float>& image);

// Size of the truth that a sequence needs.
int TruthWidth(const SequenceOptions& options);
int TruthHeight(const SequenceOptions& options);
// Where frame 0's pixel (0, 0) falls in the truth of a dwelling camera: on a cell.
Eigen::Vector2d FirstDwellCorner(const SequenceOptions& options);

// A frame by dense quadrature of Gaussian and detector over every pixel (1/4 px apart, along the sensor's axes; exact to rounding for a
// truth of 3 cells a pixel), which is not how the engine's own model works. `stream` names its noise.
Image<float> RenderFrame(const Image<float>& truth, const SequenceOptions& options, const Affine& truth_from_sensor, double gain,
                         double offset, std::uint64_t stream);

// Renders all frames from `truth` (of at least TruthWidth x TruthHeight).
RenderedSequence RenderSequence(Image<float> truth, const SequenceOptions& options);
// From a procedural truth.
RenderedSequence RenderSequence(const SequenceOptions& options);

// PSNR [dB, of 255] of samples `x` against `y` after the one gain and offset that fit best; nothing for fewer than 2000 samples.
std::optional<double> Psnr(const std::vector<double>& x, const std::vector<double>& y);

// A snapshot of the segment that began at frame `first` against the filtered truth, on the truth's cells that frames
// [seen_min, seen_max) have seen, and the bicubic enlargement of frame `first` on all of its own.
struct SnapshotScore {
  std::optional<double> scene_db;
  std::optional<double> bicubic_db;
};
SnapshotScore ScoreSnapshot(const RenderedSequence& sequence, const Image<float>& filtered_truth, const SceneSnapshot& snapshot, int first,
                            double seen_min, double seen_max);

// Largest error of a ROI corner [sensor px] of a chain entry of the segment that began at frame `first`.
double CornerError(const RenderedSequence& sequence, const ChainEntry& entry, int first);

}  // namespace trem::testing
