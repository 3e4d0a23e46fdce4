#pragma once

#include <cstddef>

namespace trem {

// The inner loops of the registration methods that evaluate many views: sample the prediction at the pixels of a list, and sum up how well
// it explains them. Vectorised with Highway, dispatched at run time. Elementwise operations are single-precision multiplications and
// additions (never fused), and every sum runs in eight lanes that are joined in one order, so all instruction sets give the same bytes.
//
// All counts are multiples of kPixelBlock; a pixel of weight 0 fills up a block and is ignored.
inline constexpr std::size_t kPixelBlock = 8;

// The prediction on its grid, and how often each cell has been seen.
struct PredictionGrid {
  const float* prediction = nullptr;  // height x width.
  const float* seen = nullptr;        // height x width.
  int width = 0;
  int height = 0;
  float seen_min = 0.0F;  // Cells seen less often are not used.
};

// grid = (m0 x + m1 y + m2, m3 x + m4 y + m5) / w, w = m6 x + m7 y + 1 when `projective`, else 1.
struct PixelMap {
  float m[8] = {1, 0, 0, 0, 1, 0, 0, 0};
  bool projective = false;
};

// A list of pixels in structure-of-arrays form.
struct PixelSpan {
  const float* x = nullptr;
  const float* y = nullptr;
  const float* intensity = nullptr;
  const float* weight = nullptr;
  std::size_t count = 0;
};

// value[i] = P(map(x, y)) by Keys' bicubic and trust[i] = weight * n / (n + 1), n the seen count of the nearest cell; both 0 where the
// 4 x 4 support leaves the grid or the nearest cell is not usable.
void SamplePixels(const PredictionGrid& grid, const PixelMap& map, const PixelSpan& pixels, float* value, float* trust);

// Weighted moments of r = intensity - gain * value - offset and p = value - centre; `missing` is the weight of the pixels without trust.
struct PixelMoments {
  double s = 0.0;
  double p = 0.0;
  double pp = 0.0;
  double r = 0.0;
  double rp = 0.0;
  double rr = 0.0;
  double missing = 0.0;
};
// `factor` (null: all 1) multiplies the trust.
PixelMoments SumMoments(const PixelSpan& pixels, const float* value, const float* trust, const float* factor, float gain, float offset,
                        float centre);

// sum of trust * rho(r / sigma), rho Huber's with corner k, and the weight of the pixels without trust.
struct PixelCost {
  double huber = 0.0;
  double missing = 0.0;
};
PixelCost SumHuber(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k);

// factor[i] = min(1, k sigma / |r|), Huber's weight; 1 where there is no trust.
void HuberFactors(const PixelSpan& pixels, const float* value, const float* trust, float gain, float offset, float sigma, float k,
                  float* factor);

}  // namespace trem
