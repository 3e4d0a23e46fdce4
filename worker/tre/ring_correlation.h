#pragma once

#include "mosaic/base/image.h"

namespace trem {

// The frequency [cycles a cell] up to which two pictures of the same ground agree: the first ring on which their Fourier ring correlation
//
//   Re sum A conj(B) / sqrt(sum |A|^2 sum |B|^2)     over the ring, summed over tiles of 64 x 64 cells
//
// falls below 1/7, interpolated between rings 1/64 cycle a cell apart; 1/2 when it never does. With noise that is independent in the two,
// 1/7 is where the mean of both has a signal-to-noise ratio of 1/3 (M. van Heel, M. Schatz, Fourier shell correlation threshold criteria,
// J. Struct. Biol. 151, 2005). It does not change when either picture is filtered.
//
// `a` and `b` have one size; NaN: not seen. 0 when no tile is seen in both.
double AgreementLimit(const Image<float>& a, const Image<float>& b);

}  // namespace trem
