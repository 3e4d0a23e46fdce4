// Goal: corner displacements are a faithful chart of affine and of projective views. Method: round trips over random views, ROIs and displacements.
#include "worker/registration/view.h"

#include <gtest/gtest.h>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

struct Case {
  PlanarMap view;
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
  c.d.resize(6);
  for (int k = 0; k < 6; ++k) c.d(k) = 2.0 * rng->Normal();
  return c;
}

TEST(View, DisplaceAndCornerDisplacementAreInverse) {
  Rng rng({1});
  for (int k = 0; k < 300; ++k) {
    const Case c = RandomCase(&rng);
    const PlanarMap moved = Displace(c.view, c.roi, c.d);
    EXPECT_LT((CornerDisplacement(c.view, moved, c.roi) - c.d).norm(), 1e-9) << "case " << k;
    const PlanarMap back = Displace(c.view, c.roi, CornerDisplacement(c.view, moved, c.roi));
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

// A view with perspective that changes its depth by up to a fifth over the ROI.
Case RandomProjectiveCase(Rng* rng) {
  Case c = RandomCase(rng);
  c.view.perspective = Eigen::Vector2d(rng->Normal(), rng->Normal()) * 0.05 / (c.roi.x1 + c.roi.y1);
  c.d.resize(8);
  for (int k = 0; k < 8; ++k) c.d(k) = rng->Normal();
  return c;
}

double LargestDifference(const PlanarMap& a, const PlanarMap& b, const Roi& roi) { return LargestCornerMotion(a, b, roi); }

TEST(View, ProjectiveDisplaceAndCornerDisplacementAreInverse) {
  Rng rng({3});
  for (int k = 0; k < 300; ++k) {
    const Case c = RandomProjectiveCase(&rng);
    const PlanarMap moved = Displace(c.view, c.roi, c.d);
    EXPECT_LT((CornerDisplacement(c.view, moved, c.roi, ViewModel::kProjective) - c.d).norm(), 1e-8) << "case " << k;
    const PlanarMap back = Displace(c.view, c.roi, CornerDisplacement(c.view, moved, c.roi, ViewModel::kProjective));
    EXPECT_LT(LargestDifference(back, moved, c.roi), 1e-8);
  }
}

TEST(View, AProjectiveDisplacementOfThreeCornersThatIsAffineIsTheAffineOne) {
  Rng rng({4});
  for (int k = 0; k < 100; ++k) {
    const Case c = RandomCase(&rng);
    CornerVector d(8);
    d << c.d, c.d.segment<2>(2) + c.d.segment<2>(4) - c.d.segment<2>(0);
    EXPECT_LT(LargestDifference(Displace(c.view, c.roi, d), Displace(c.view, c.roi, c.d), c.roi), 1e-9);
  }
}

TEST(View, TheCornerJacobianIsTheDerivativeOfTheDisplacement) {
  Rng rng({5});
  constexpr double kStep = 1e-4;
  for (int k = 0; k < 50; ++k) {
    const Case c = RandomProjectiveCase(&rng);
    const Eigen::Vector2d u(c.roi.x0 + rng.Uniform() * c.roi.width(), c.roi.y0 + rng.Uniform() * c.roi.height());
    for (const ViewModel model : {ViewModel::kAffine, ViewModel::kProjective}) {
      const auto jacobian = CornerJacobian(c.roi, u, model);
      for (int i = 0; i < ParameterCount(model); ++i) {
        CornerVector d = CornerVector::Zero(ParameterCount(model));
        d(i) = kStep;
        const Eigen::Vector2d forward = Displace(PlanarMap{}, c.roi, d) * u;
        const Eigen::Vector2d backward = Displace(PlanarMap{}, c.roi, -d) * u;
        EXPECT_LT(((forward - backward) / (2.0 * kStep) - jacobian.col(i)).norm(), 1e-6) << "parameter " << i;
      }
    }
  }
}

TEST(View, AffineMapsStayExactlyAffine) {
  Rng rng({6});
  const Case c = RandomCase(&rng);
  const PlanarMap moved = Displace(c.view, c.roi, c.d);
  EXPECT_TRUE(moved.IsAffine());
  EXPECT_TRUE((moved.Inverse() * c.view).IsAffine());
}

TEST(View, LargestCornerMotionLooksAtAllFourCorners) {
  const Roi roi{0, 0, 11, 11};
  Affine view;
  view.linear *= 3.0;
  EXPECT_EQ(LargestCornerMotion(view, view, roi), 0.0);
  // Upper right and lower left move by 1 px in x: the lower right one by 2.
  CornerVector d(6);
  d << 0, 0, 1, 0, 1, 0;
  EXPECT_NEAR(LargestCornerMotion(view, Displace(view, roi, d), roi), 2.0, 1e-12);
}

}  // namespace
}  // namespace trem
