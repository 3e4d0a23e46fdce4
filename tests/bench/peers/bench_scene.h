#pragma once

#include <string>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"
#include "tests/support/rendered_sequence.h"
#include "worker/sensor/psf.h"

namespace trem::bench {

// What every method in the quality benches gets, and what its answer is measured against.
//
// Answers are on frame 0's scene grid: image of AnswerSide() x AnswerSide(), cell (x, y) is 3 * frame 0's pixel coordinates. The camera
// dwells (CameraMotion::kDwell), so cell (x, y) of an answer is a cell of the truth, and answers are scored without resampling.
struct BenchScene {
  std::string name;
  bool natural = false;  // From a photograph.
  testing::SequenceOptions options;
  testing::RenderedSequence sequence;
  Image<float> target;  // The truth filtered by [1 2 1] / 4 in each axis, on the answers' grid.
  Roi scored;           // Of the answers' grid: seen by every frame, PSF support included.

  static constexpr int kRatio = 3;
  int AnswerSide() const { return kRatio * options.roi_px; }
  PsfParameters psf() const { return {options.psf_sigma_px, options.fill_factor}; }
  // Frame t's true view on the answers' grid.
  Affine SceneFromSensor(int t) const;
  // Frame t with its true gain and offset taken back.
  Image<float> Flattened(int t) const;
};

// Renders the frames over `truth` of testing::TruthWidth(options) x TruthHeight(options). Needs options.motion == kDwell and a multiple
// of 3 cells a pixel.
BenchScene MakeBenchScene(std::string name, bool natural, Image<float> truth, const testing::SequenceOptions& options);

// PSNR [dB of 255] of an answer on the scored cells, after the one gain and offset that fit best.
double Score(const BenchScene& scene, const Image<float>& answer);

struct ShiftedScore {
  double db = 0.0;
  double shift_x = 0.0;  // Cells that the answer was moved by.
  double shift_y = 0.0;
};
// The same at the shift of the answer [cells, within +-2 of the start, steps of 0.05] that scores best: for peers with conventions of
// their own.
ShiftedScore ScoreAtBestShift(const BenchScene& scene, const Image<float>& answer, double start_x, double start_y);

// `image` at (x, y), continued beyond its border by its outermost samples.
float SampleClamped(const Image<float>& image, double x, double y);

// Frame 0 enlarged bicubically.
Image<float> Bicubic(const BenchScene& scene);

}  // namespace trem::bench
