#pragma once

#include <string>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// Finds the black borders that recorders and converters leave around a video: rows and columns at the edges that stay near black, wholly
// or nearly so, in all frames while the picture beside them does not. Feed it frames as they come; memory is one number a row and column.
class BorderFinder {
 public:
  BorderFinder(int width_px, int height_px);

  // Mean brightness of a frame's columns and rows.
  struct LineMeans {
    std::vector<double> columns;
    std::vector<double> rows;
  };
  static LineMeans MeansOf(const Image<float>& frame);

  // Of a frame of the constructor's size, non-negative grey levels.
  void Add(const LineMeans& means);
  void Add(const Image<float>& frame) { Add(MeansOf(frame)); }

  struct Finding {
    Roi valid_roi;     // The whole frame when there is no border.
    std::string note;  // "8 columns at the left, ..."; empty without a border.
  };
  // Where a border was found, two more rows or columns are cut: the picture fades in there.
  Finding Find() const;

 private:
  // One row or column, over the frames; brightness relative to the frame's own (0 black, about 1 ordinary).
  struct Line {
    double relative_sum = 0.0;
    int black_count = 0;
  };
  // Lines to cut at the beginning of `lines`.
  int BorderWidth(const std::vector<Line>& lines) const;

  int frame_count_ = 0;
  std::vector<Line> columns_;
  std::vector<Line> rows_;
};

}  // namespace trem
