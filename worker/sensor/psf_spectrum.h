#pragma once

#include <Eigen/Core>

#include "worker/sensor/psf.h"

namespace trem {

// Incoherent modulation transfer function of an aberration-free circular aperture at `frequency` / cut-off = v:
//
//   (2 / pi) (acos v - v sqrt(1 - v^2)) for v < 1, 0 above.
//
// Source: J. W. Goodman, Introduction to Fourier Optics, 3rd ed., 6.3.2. Cut-off [cycles/px]: 1 / q.
double DiffractionMtf(double v);

// The transfer function of a kGaussian or kOptics sensor at (fx, fy) [cycles a sensor pixel]: diffraction (kOptics) * sinc of the
// detector's box * Gaussian * sinc of the smear. Real, because each factor is symmetric about the origin.
double TransferFunction(const PsfParameters& parameters, double fx, double fy);

// Point samples [per cell^2, not normalised] of the PSF at the cell centres of a grid `ratio` times finer than the sensor, (2 radius + 1)
// a side, rows along y. The inverse Fourier integral as a sum over frequencies 1/64 cycle/px apart up to the transfer function's end:
// exact for the PSF repeated every 64 px, whose copies add less than 1e-5 of the peak.
Eigen::MatrixXd SampleSpectrum(const PsfParameters& parameters, int ratio, int radius);

}  // namespace trem
