#pragma once

#include <span>

#include "worker/registration/registration.h"
#include "worker/tre/scene_buffer.h"
#include "worker/tre/structure_prior.h"

namespace trem {

// What turns the frames seen so far into a better scene.
enum class UpdateMethod {
  kInformation,  // InformationUpdate: accelerated steps on the accumulated samples.
  kLandweber,    // LandweberUpdate: gradient steps on the last frames themselves.
  kPointwise,    // PointwiseUpdate: cell after cell on the accumulated samples.
};

// A frame that a scheme keeps, its pixels included. May be registered again; see UpdateScheme::kept_frames.
struct KeptFrame {
  int frame_index = 0;
  Roi roi;
  double noise_sigma = 2.0;
  Image<float> pixels;
  Image<float> weights;  // Empty: all 1.
  View view;

  Observation observation() const { return {&pixels, roi, noise_sigma, weights.empty() ? nullptr : &weights}; }
};

// A scheme other than the information update, which counts and predicts for all of them (SceneBuffer::seen, weight, weighted and
// prediction are its). A scheme improves buffer->scene and nothing else; deterministic.
class UpdateScheme {
 public:
  virtual ~UpdateScheme() = default;
  // A registered frame, after its samples were added to the buffer.
  virtual void AddFrame(int frame_index, const Observation& observation, const View& view) = 0;
  // `iterations` steps or sweeps on `region` (scene plane) of the data term + lambda * prior.
  virtual void Iterate(const Roi& region, int iterations, const StructurePrior& prior, float lambda, SceneBuffer* buffer) = 0;
  // Whether the scheme still holds the data of all seen ground in the buffer, and not only of what the last frames saw: else steps on
  // older ground would follow the prior alone.
  virtual bool remembers() const = 0;
  // Frames whose views may still be improved: a change counts from the next Iterate on. Oldest first; empty for schemes that keep none.
  virtual std::span<KeptFrame> kept_frames() { return {}; }
};

}  // namespace trem
