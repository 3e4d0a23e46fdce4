#pragma once

#include <vector>

#include "mosaic/base/status.h"
#include "worker/sensor/psf_kernel.h"

namespace trem {

// One separable term of a point spread function: row[i + r] * column[j + r] at the displacement (i, j) [cells] from a point source,
// |i|, |j| <= r. `row` runs along x.
struct PsfTerm {
  std::vector<float> row;
  std::vector<float> column;
};

// A point spread function on the scene grid, as what a point source of one cell leaves there:
//
//   h(i, j) = taps[|i|] * taps[|j|]                          rank one and symmetric (`terms` is empty), or
//   h(i, j) = sum_t terms[t].row[i + r] * terms[t].column[j + r]
//
// h sums to 1 to float rounding. With several terms h may be negative by `negative_mass` altogether, which the tolerance of the
// decomposition bounds (see DecomposeKernel).
struct Psf {
  std::vector<float> taps;     // taps[0] is the centre; 2 * sum(taps[1..]) + taps[0] == 1.
  std::vector<PsfTerm> terms;  // All of one radius.
  double negative_mass = 0.0;  // Sum of -h over the cells where h < 0.

  bool is_rank_one_symmetric() const { return terms.empty(); }
  int radius() const { return terms.empty() ? static_cast<int>(taps.size()) - 1 : static_cast<int>(terms.front().row.size() / 2); }
};

// The usual sensor's: one separable symmetric term.
using SeparablePsf = Psf;

enum class PsfModel {
  kGaussian,    // Gaussian optics and the detector's box.
  kOptics,      // Diffraction by a circular aperture, the detector's box, and the Gaussian when sigma_px > 0.
  kKernelFile,  // A measured kernel, detector included.
};

// What is known of the sensor, in sensor pixels.
struct PsfParameters {
  double sigma_px = 0.55;             // Gaussian part (optics, defocus, residual motion). 0.05 .. 3; kOptics: 0 for none.
  double fill_factor = 0.9;           // Side of the detector's box, (0, 1].
  PsfModel model = PsfModel::kGaussian;
  double q = 0.0;                     // kOptics: wavelength * f_number / pixel_pitch, kOpticsQMin .. kOpticsQMax.
  double smear_px = 0.0;              // Linear motion during the exposure: length, 0 .. 10; on top of every model.
  double smear_direction_rad = 0.0;   // From x towards y (clockwise as seen).
  PsfKernel kernel = {};              // kKernelFile.
};

// Below, diffraction is a twentieth of a pixel wide and nothing beside the detector; above, the optics cut off at a quarter of a cycle
// a pixel and the sensor already samples more than there is.
inline constexpr double kOpticsQMin = 0.05;
inline constexpr double kOpticsQMax = 4.0;
inline constexpr double kSmearMax_px = 10.0;

// The PSF of a sensor on a grid `ratio` times finer, as point samples of the continuous PSF at the cell centres, normalised. Point
// samples are exact for a scene that is band-limited on its grid and a PSF that is too, they are never negative, and the cubic sampling
// that follows reproduces quadratics, so neither widens the response to second order.
//
// kGaussian without smear: closed form (difference of error functions), truncated where less than 1e-3 of its mass remains; rank one.
// kGaussian with smear, kOptics: the inverse Fourier transform of the closed-form transfer function (SampleSpectrum), cut to the square
// that holds 99.8 % and 97 % of its mass: the wings of diffraction reach far (about 0.2 wavelength * f_number / radius of the mass lies
// beyond a radius), and what is cut there is veiling glare, a local mean, which the views' gain and offset take up.
// kKernelFile: cubic interpolation of the kernel about its centroid.
//
// kInvalidInput names the field of the spec, what was found and what was expected.
Result<Psf> MakePsf(const PsfParameters& parameters, int ratio);

}  // namespace trem
