#pragma once

#include <string>

#include "worker/tre/frame_input.h"

namespace trem {

// Turns what cannot be a measurement (infinite, or beyond +-1e6 internal grey levels) into NaN.
void DropImpossible(Image<float>* pixels);

// Why a frame cannot be used at all; empty: it can. Less than a quarter of its pixels usable, every usable pixel the same, or noise
// without an image: neighbouring pixels that vary far more than `noise_sigma` and have nothing in common, which no optics can make.
std::string WhyUnusable(const FrameInput& frame, double noise_sigma);

// Continues NaN pixels from the nearest one of their row that is not, rows without any from the nearest row: something to fill new ground
// with that makes no edge. False (and no change) when there is nothing to continue or to continue from.
bool ContinueHoles(Image<float>* pixels);

// True when `now` is `before` again: their mean absolute difference is below a quarter of the noise's sigma, where two exposures of the
// very same scene differ by 1.13 of it. A frame that was repeated and encoded again brings no new noise and thus no information.
bool Repeats(const Image<float>& now, const Image<float>& before, double noise_sigma);

}  // namespace trem
