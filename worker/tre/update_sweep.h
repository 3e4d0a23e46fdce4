#pragma once

#include <memory>
#include <span>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"
#include "worker/sensor/filter_rows.h"
#include "worker/sensor/psf.h"
#include "worker/tre/update_kernels.h"

namespace trem {

// What a sweep reads and writes; all images have the same size. The last three may be the first three when one tile covers the whole
// region.
struct SweepPlanes {
  const Image<float>* scene = nullptr;       // Y, already extrapolated.
  const Image<float>* previous = nullptr;    // X, before its extrapolation.
  const Image<float>* prediction = nullptr;  // B Y, up to the PSF's radius beyond the region.
  const Image<float>* weight = nullptr;
  const Image<float>* weighted = nullptr;
  const Image<float>* majoriser = nullptr;
  Image<float>* next_scene = nullptr;
  Image<float>* next_previous = nullptr;
  Image<float>* next_prediction = nullptr;  // Up to the radius beyond the region, too.
};

// Several accelerated steps of the information update (see InformationUpdate) on one tile in ONE pass over its rows. Every step is a
// chain of stages, each a few rows behind the one that feeds it:
//
//   R = W (B Y) - Z  ->  X = Y - (B R + lambda psi'(Y)) / (majoriser + damping)  ->  Y_next = X + m (X - X_before)
//
// and the next step begins with Y_next. B of the last one is left for the first step of the next sweep, which so has one blur less. Only a
// window of about 2 * radius rows of each stage is kept, so that Y, X, B Y, W, Z and the majoriser are read from memory once and Y, X and
// B Y written once for all the steps. Tiles recompute what they need of their neighbours (2 * radius cells to every side a step), so each
// cell's value is the same however the region is cut.
class UpdateSweep {
 public:
  explicit UpdateSweep(SeparablePsf psf) : psf_(std::move(psf)) {}

  // Runs momenta.size() >= 1 steps, momenta[k] that after step k. `region` [cells of the images, within them] is where the scene moves;
  // `tile` the part of it that is written, of the prediction with what lies within the radius of it beyond the region. Scratch memory is
  // kept between calls; one object per thread.
  void Run(const SweepPlanes& planes, const Roi& region, const Roi& tile, std::span<const float> momenta, const StepWeights& weights);

 private:
  // The last rows of one stage; row y stands where row y - depth stood. Rows begin at whole cache lines.
  class Ring {
   public:
    void Fit(int depth, int stride);
    float* row(int y) { return begin_ + static_cast<std::size_t>(y % depth_) * static_cast<std::size_t>(stride_); }

   private:
    std::vector<float> data_;
    float* begin_ = nullptr;  // The first whole cache line of data_.
    int depth_ = 1;
    int stride_ = 0;
  };

  // One step: where its result is computed, and the wider rectangles on which that needs residuals and the scene that it starts from. After
  // the last step stands one with a start only.
  struct Step {
    Roi out;
    Roi context;
    Roi support;
    float momentum = 0.0F;
    Ring start;
    Ring residual;
    Ring result;
    int next_start = 0;
    int next_residual = 0;
    int next_result = 0;
  };

  void Prepare(const Roi& tile, std::span<const float> momenta);
  // Each makes its stage of step k ready up to row `last` at least: a few rows at a time, so that the rows that a filter reads are
  // fetched from the second-level cache for several rows of its output.
  void MakeStart(std::size_t k, int last);
  void MakeResidual(std::size_t k, int last);
  void MakeResult(std::size_t k, int last);
  void MakePrediction(int begin, int end);
  // Rows of a block of `row_count` from columns [x0, x1) on; its input is rows_.
  FilterBlock BlockOf(int row_count, int x0, int x1);
  // Row y of step k as its kernel wants it.
  StepRow RowOf(std::size_t k, int y);
  void WriteResult(int y);
  void FillBeside(int y, int begin, int inner_begin, int inner_end, int end, float* line) const;

  int width() const { return planes_.scene->width(); }
  int height() const { return planes_.scene->height(); }
  // Lines start at column origin_ of the images; this is where column x of them is.
  float* Line(float* line, int x = 0) const { return line + (x - origin_); }

  SeparablePsf psf_;
  SweepPlanes planes_;
  StepWeights weights_;
  Roi region_;
  Roi tile_;
  Roi predicted_;  // Where the tile writes the prediction.
  int origin_ = 0;
  int stride_ = 0;
  std::size_t count_ = 0;
  std::vector<Step> steps_;
  Ring lines_;
  std::vector<const float*> rows_;
};

}  // namespace trem
