#pragma once

#include <span>

#include "mosaic/composite/median.h"

namespace trem {

// What one scene says of a row of pixels. Columns [begin, end) are given; column x is element x - begin of the planes.
struct SampleRow {
  int begin = 0;
  int end = 0;
  const float* value = nullptr;       // Finite, also where the weight is 0.
  const float* weight = nullptr;      // 0: no sample.
  const float* saturation = nullptr;  // How far the sample's information is from all that it could be, [0, 1): see CompositeOptions.
  float sigma2 = 0.0f;                // Squared standard error of position, CRS units.
  float source = 0.0f;                // What the `source` plane gets where this row dominates.
};

// Where the results of columns [0, count) go.
struct ReducedRow {
  float* value = nullptr;           // NaN where nothing covers the pixel.
  float* count = nullptr;           // Samples that took part.
  float* nmad = nullptr;            // NaN where fewer than 2 took part.
  float* position_sigma = nullptr;  // Root of the weighted mean of sigma2; NaN where nothing covers the pixel.
  float* source = nullptr;          // Of the heaviest sample, the first one among equals; `no_source` where nothing covers the pixel.
};

struct ReduceOptions {
  MedianOptions median;
  // A sample with a saturation below a half AND below this part of the pixel's best does not take part.
  float poor_ratio = 0.5f;
  float no_source = -1.0f;
};

// Reduces every column of [0, count) as ReducePixel does, bit for bit, whatever the vectors of this processor: as many pixels at a time as
// a vector has lanes. Nothing is sorted; what lies below each sample is found by comparing all pairs (with Estimator::kMedian up to 8 rows
// go through a network of compare and exchange instead: Batcher's merge exchange, Knuth, TAOCP vol. 3, 5.2.2 M). Samples that do not take
// part have weight 0 and add exactly nothing, so that rows which say nothing of a pixel do not change it. Cost: about n^2 / lanes
// operations a pixel, twice (value and spread), and up to 8 rows in registers alone.
void ReduceRow(std::span<const SampleRow> rows, int count, const ReduceOptions& options, const ReducedRow& out);

}  // namespace trem
