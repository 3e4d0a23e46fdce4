#pragma once

#include <cstdint>
#include <vector>

#include "tests/support/rendered_sequence.h"

namespace trem::testing {

// Faults of real sensors and scenes, put into rendered frames.

// A bias per sensor pixel of Gaussian spread, the same in every frame. Returned.
Image<float> AddFixedPattern(double sigma, std::uint64_t seed, RenderedSequence* sequence);

// Turns a part of the sensor's pixels dead (0), hot (255), stuck (a constant in between) or blinking (dead in half of the frames), by
// turns. Returns their indices in the ROI.
std::vector<int> AddBadPixels(double part, std::uint64_t seed, RenderedSequence* sequence);

// A rectangle of `side_px` sensor pixels and of grey level `grey` that moves over the sensor, opaque; its edge pixels are mixed. Position
// of its centre in frame `begin` and velocity a frame, sensor pixels; frames [begin, end).
struct Mover {
  double side_px = 9.0;
  double grey = 230.0;
  double x = 40.0;
  double y = 40.0;
  double speed_x = 1.0;
  double speed_y = 0.5;
  int begin = 0;
  int end = 1 << 30;
};
void AddMover(const Mover& mover, RenderedSequence* sequence);

// gain and offset applied to all frames from `frame` on.
void JumpBrightness(double gain, double offset, int frame, RenderedSequence* sequence);

// Clips at `level`, and gives clipped pixels weight 0 when `weighted`.
void Saturate(double level, bool weighted, RenderedSequence* sequence);

}  // namespace trem::testing
