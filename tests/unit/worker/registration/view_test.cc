// Goal: corner displacements are a faithful chart of affine views. Method: round trips over random views, ROIs and displacements.
#include "worker/registration/view.h"

#include <gtest/gtest.h>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

struct Case {
  Affine view;
  Roi roi;
  CornerVector d;
};

Case RandomCase(Rng* rng) {
  Case c;
  c.view.linear << 3.0 + rng->Normal() * 0.3, rng->Normal() * 0.5, rng->Normal() * 0.5, 3.0 + rng->Normal() * 0.3;
  c.view.offset = {100.0 * rng->Normal(), 100.0 * rng->Normal()};
  const int x0 = static_cast<int>(rng->UniformIndex(500));
  const int y0 = static_cast<int>(rng->UniformIndex(500));
  c.roi = {x0, y0, x0 + 16 + static_cast<int>(rng->UniformIndex(200)), y0 + 16 + static_cast<int>(rng->UniformIndex(200))};
  for (int k = 0; k < 6; ++k) c.d(k) = 2.0 * rng->Normal();
  return c;
}

TEST(View, DisplaceAndCornerDisplacementAreInverse) {
  Rng rng({1});
  for (int k = 0; k < 300; ++k) {
    const Case c = RandomCase(&rng);
    const Affine moved = Displace(c.view, c.roi, c.d);
    EXPECT_LT((CornerDisplacement(c.view, moved, c.roi) - c.d).norm(), 1e-9) << "case " << k;
    const Affine back = Displace(c.view, c.roi, CornerDisplacement(c.view, moved, c.roi));
    EXPECT_LT((back.linear - moved.linear).norm() + (back.offset - moved.offset).norm(), 1e-8);
  }
}

TEST(View, ADisplacementMovesAPointByItsCornerWeights) {
  Rng rng({2});
  for (int k = 0; k < 300; ++k) {
    const Case c = RandomCase(&rng);
    const Eigen::Vector2d u(c.roi.x0 + rng.Uniform() * c.roi.width(), c.roi.y0 + rng.Uniform() * c.roi.height());
    const Eigen::Vector3d w = CornerWeights(c.roi, u);
    EXPECT_NEAR(w.sum(), 1.0, 1e-12);
    Eigen::Vector2d moved = u;
    for (int corner = 0; corner < 3; ++corner) moved += w(corner) * c.d.segment<2>(2 * corner);
    EXPECT_LT((Displace(c.view, c.roi, c.d) * u - c.view * moved).norm(), 1e-9);
  }
}

TEST(View, LargestCornerMotionLooksAtAllFourCorners) {
  const Roi roi{0, 0, 11, 11};
  Affine view;
  view.linear *= 3.0;
  EXPECT_EQ(LargestCornerMotion(view, view, roi), 0.0);
  // Upper right and lower left move by 1 px in x: the lower right one by 2.
  CornerVector d;
  d << 0, 0, 1, 0, 1, 0;
  EXPECT_NEAR(LargestCornerMotion(view, Displace(view, roi, d), roi), 2.0, 1e-12);
}

}  // namespace
}  // namespace trem
