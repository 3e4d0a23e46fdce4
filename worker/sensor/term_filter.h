#pragma once

#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"
#include "worker/sensor/psf.h"

namespace trem {

// Filtering with any PSF, as a sum of separable terms, and its exact adjoint. The image is continued by half-sample reflection
// (... b a | a b c ...); for a kernel that is not symmetric that makes B' another operator than reflecting and filtering with the
// turned kernel: what B read beyond a border, B' must fold back.
class TermFilter {
 public:
  // output(x, y) = (B input)(x, y), or (B' input)(x, y), for (x, y) in `region`, which lies in the image. Both read `input` up to the
  // radius beyond the region. Cost: 2 (2 radius + 1) multiply-adds a pixel and term.
  void Apply(const Psf& psf, const Image<float>& input, const Roi& region, Image<float>* output);
  void ApplyAdjoint(const Psf& psf, const Image<float>& input, const Roi& region, Image<float>* output);

 private:
  void FilterRows(const PsfTerm& term, const Image<float>& input, const Roi& region);
  void GatherRows(const PsfTerm& term, const Image<float>& input, const Roi& region);

  Image<float> rows_;          // Filtered along x: the region's columns, `radius` rows above and below it.
  std::vector<float> padded_;  // One row with what lies beside it.
};

}  // namespace trem
