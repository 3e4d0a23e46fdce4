#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"
#include "worker/sensor/psf.h"
#include "worker/sensor/term_filter.h"

namespace trem {

// Convolves images with a PSF. The image is continued by half-sample reflection at its borders (... b a | a b c ...), which makes the
// operator B of a symmetric PSF exactly symmetric: <B x, y> == <x, B y>, so that B is its own adjoint; others have one of their own.
// Keeps scratch memory between calls; one per thread.
class Blur {
 public:
  explicit Blur(Psf psf) : psf_(std::move(psf)) {}

  // output(x, y) for (x, y) in `region` (clipped to the image); other pixels of `output` are left alone. `output` has the size of
  // `input` and is another image. Cost, rank one and symmetric: 2 (radius + 1) multiplications and 4 radius additions a pixel, in
  // float32; else see TermFilter.
  void Apply(const Image<float>& input, const Roi& region, Image<float>* output);
  void Apply(const Image<float>& input, Image<float>* output) { Apply(input, {0, 0, input.width(), input.height()}, output); }

  // The same for B': <B x, y> == <x, B' y> up to rounding.
  void ApplyAdjoint(const Image<float>& input, const Roi& region, Image<float>* output);
  void ApplyAdjoint(const Image<float>& input, Image<float>* output) { ApplyAdjoint(input, {0, 0, input.width(), input.height()}, output); }

  const Psf& psf() const { return psf_; }

 private:
  Psf psf_;
  std::vector<float> lines_;          // A few rows filtered down the columns, with their reflected borders.
  std::vector<const float*> source_;  // The rows that feed them.
  TermFilter terms_;
};

}  // namespace trem
