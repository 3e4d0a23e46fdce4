#pragma once

#include <Eigen/Core>
#include <filesystem>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "worker/simulate/records.h"
#include "worker/simulate/surface.h"

namespace trem::score {

// A mosaic to be scored: grey levels, NaN where it has no value.
struct MosaicImage {
  Image<float> grey;
  MosaicGrid grid;
};

// Band 1 of a raster; its mask, nodata value and NaN all mean "no value". `truth_crs_wkt` is the CRS that it must be in. kInvalidInput
// when it is another one, or the raster is not north up with square pixels.
Result<MosaicImage> ReadMosaic(const std::filesystem::path& path, const std::string& truth_crs_wkt);

// What a 3:1 grid can carry of the truth: [1 2 1]/4 along each axis with taps a third of a sensor pixel apart, as a surface that can be
// taken anywhere.
class Reference {
 public:
  explicit Reference(const SimulationRecord& record);

  // Whether the truth reaches a point [map metres].
  bool Covers(const Eigen::Vector2d& x_in_map) const;
  // The filtered truth there; outside, the nearest value inside.
  double At(const Eigen::Vector2d& x_in_map) const;
  // The filtered truth on a grid whose content stands `shift_m` away from where it should: pixel p gets At(world(p) - shift_m).
  Image<float> OnGrid(const MosaicGrid& grid, const Eigen::Vector2d& shift_m) const;

 private:
  MosaicGrid truth_grid_;
  SplineSurface surface_;
};

// The single frame to compare with: for every pixel of `grid` the bicubic interpolation (Keys, a = -1/2) of one frame at its true place
// with its true gain and offset undone. Of the frames that see the pixel it is the one whose centre is nearest (order decided once a
// block of 16 x 16 pixels). NaN where no frame does. `shift_m` as in Reference::OnGrid. Reads the frames of `simulation`.
Result<Image<float>> BicubicFrames(const std::filesystem::path& simulation, const SimulationRecord& record, const MosaicGrid& grid,
                                   const Eigen::Vector2d& shift_m);

// Fraction of the ground seen by at least one frame, less a border of 3 sensor pixels, where the mosaic (standing `shift_m` off) has a
// value. Counted on cells of one sensor pixel.
double Coverage(const SimulationRecord& record, const MosaicImage& mosaic, const Eigen::Vector2d& shift_m);

}  // namespace trem::score
