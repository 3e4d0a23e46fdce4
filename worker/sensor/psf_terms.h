#pragma once

#include <Eigen/Core>

#include "worker/sensor/psf.h"

namespace trem {

// The part of a PSF's mass that its separable terms may get wrong: sum |h - sum of terms| <= kDecompositionTolerance * sum h, so that the
// blurred value of a scene in 0..255 is within 0.03 grey levels.
inline constexpr double kDecompositionTolerance = 1e-4;

// Writes a kernel (odd, square, non-negative, rows along y) as the fewest separable terms of its singular value decomposition that meet
// the tolerance, and normalises them to sum 1. Deterministic: the sign of each pair is fixed by its largest row tap.
// Source: S. Treitel & J. L. Shanks, IEEE Trans. Geosci. Electron. 9(1), 1971.
Psf DecomposeKernel(const Eigen::MatrixXd& kernel);

// The kernel that the terms (or taps) add up to, (2 radius + 1) a side, rows along y.
Eigen::MatrixXd KernelOf(const Psf& psf);

}  // namespace trem
