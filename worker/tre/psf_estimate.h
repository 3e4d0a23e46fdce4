#pragma once

#include <string>

#include "worker/tre/frame_spectrum.h"

namespace trem {

// The width of the Gaussian part of the PSF, and the white noise, as the frames' power spectrum shows them.
struct PsfEstimate {
  double sigma_px = 0.0;        // 0: nothing could be estimated, and `doubt` says why.
  double error_px = 0.0;        // Standard error.
  double noise_sigma = 0.0;     // White noise [grey levels of the frames], quantisation included; 0: the spectrum does not show it.
  double scene_exponent = 0.0;  // The ground's spectrum falls with this power of the frequency.
  double misfit = 0.0;          // Rms of the log power about the model.
  std::string doubt;            // Empty: the estimate can be used.
};

// Open ground, like every picture of objects that hide one another, has a power spectrum that falls with a power of the frequency near 2
// (D. L. Ruderman, Origins of scaling in natural images, Vision Research 37, 1997). What the frames show less at high frequencies the
// sensor has taken:
//
//   P(f) = sum over aliases k of A(angle) |f + k|^-b exp(-4 pi^2 sigma^2 |f + k|^2) box(f + k)^2 + N
//
// with box the transfer function of a detector of `fill_factor` px, log A a Fourier series of the angle to the fourth harmonic (roads
// and rows of houses have directions), and b about 2.05 +- 0.25. A, b, sigma and N are fitted to the log of the averaged power, robustly. A
// fall-off is the same at any scale, so perspective and zoom do no harm.
//
// The error is that of the fit, with as many independent residuals as there are features a spectrum deviates by (about 25), and not less
// than what photographs of known blur show. Doubt: too few tiles, power that fits no such model (strong compression, periodic
// structures), or noise that hides the fall-off. Deterministic: values are rounded to 0.001.
PsfEstimate EstimatePsfSigma(const FrameSpectrum& spectrum, double fill_factor);

}  // namespace trem
