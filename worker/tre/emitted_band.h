#pragma once

#include "mosaic/base/image.h"
#include "worker/sensor/blur.h"

namespace trem {

// A scene as it is handed out: filtered by [1 2 1] / 4 along rows and columns.
//
// S lives on a grid that is finer than what the frames can tell: near the grid's Nyquist frequency (1.5 cycles a sensor pixel at 3:1)
// the detector passes next to nothing, and what S holds there is noise and the prior's guess. The filter takes that out and leaves what
// is known (two thirds at 0.6 cycles a pixel). Inside the engine S itself is kept: the sensor model blurs it on its own.
inline Image<float> InEmittedBand(const Image<float>& scene) {
  Image<float> filtered(scene.width(), scene.height());
  Blur(Psf{{0.5F, 0.25F}, {}, 0.0}).Apply(scene, &filtered);
  return filtered;
}

}  // namespace trem
