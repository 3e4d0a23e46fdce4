// Goal: a gridded ground is what its nodes say, and rays end where they first meet it. Method: a plane, of which bilinear interpolation
// is exact, against its closed form; a ridge that hides the ground behind it; rays that must not meet anything.
#include "mosaic/geometry/ground_surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace trem {
namespace {

constexpr int kSide = 41;
constexpr double kStep_m = 10.0;

// Nodes at x = -200 .. 200, y = 200 .. -200.
template <typename F>
GriddedGround Grid(F elevation) {
  Image<float> nodes(kSide, kSide);
  for (int r = 0; r < kSide; ++r) {
    for (int c = 0; c < kSide; ++c) nodes.at(c, r) = static_cast<float>(elevation(-200.0 + kStep_m * c, 200.0 - kStep_m * r));
  }
  return GriddedGround({-200.0, 200.0}, {kStep_m, -kStep_m}, std::move(nodes));
}

TEST(GroundSurface, BilinearElevationsOfAPlaneAreExactUpToTheEdgeAndUnknownBeyond) {
  const GriddedGround ground = Grid([](double x, double y) { return 50.0 + 0.25 * x - 0.5 * y; });
  for (const Eigen::Vector2d& x : {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(3.7, -118.2), Eigen::Vector2d(200.0, -200.0)}) {
    ASSERT_TRUE(ground.ElevationAt(x).has_value());
    EXPECT_NEAR(*ground.ElevationAt(x), 50.0 + 0.25 * x.x() - 0.5 * x.y(), 1e-4);
  }
  EXPECT_FALSE(ground.ElevationAt({200.1, 0.0}).has_value());
  EXPECT_FALSE(ground.ElevationAt({0.0, -200.1}).has_value());
  EXPECT_FALSE(ground.ElevationAt({std::numeric_limits<double>::quiet_NaN(), 0.0}).has_value());
  EXPECT_NEAR(ground.lowest_m(), 50.0 - 50.0 - 100.0, 1e-4);
  EXPECT_NEAR(ground.highest_m(), 50.0 + 50.0 + 100.0, 1e-4);
  EXPECT_NEAR(ground.mean_m(), 50.0, 1e-4);
}

TEST(GroundSurface, CellsWithAnUnknownNodeAreUnknown) {
  const GriddedGround ground = Grid([](double x, double y) { return x == 0.0 && y == 0.0 ? std::nan("") : 7.0; });
  EXPECT_FALSE(ground.ElevationAt({4.0, -4.0}).has_value());
  EXPECT_EQ(ground.ElevationAt({14.0, -4.0}), 7.0);
}

TEST(GroundSurface, RaysMeetASlopeWhereTheClosedFormSays) {
  const GriddedGround ground = Grid([](double x, double y) { return 30.0 + 0.2 * x + 0.1 * y; });
  const Eigen::Vector3d position(-20.0, 40.0, 500.0);
  const Eigen::Vector3d normal(-0.2, -0.1, 1.0);
  for (const Eigen::Vector3d& direction :
       {Eigen::Vector3d(0.0, 0.0, -1.0), Eigen::Vector3d(0.3, -0.4, -2.0), Eigen::Vector3d(-1.0, 1.0, -9.0)}) {
    const auto x = IntersectSurface(position, direction, ground);
    ASSERT_TRUE(x.has_value());
    const double s = (30.0 - normal.dot(position)) / normal.dot(direction);
    EXPECT_LT((*x - (position + s * direction)).norm(), 5e-3);
  }
}

TEST(GroundSurface, RaysMeetAGridOfOneElevation) {
  const GriddedGround ground = Grid([](double, double) { return 40.0; });
  const auto x = IntersectSurface({3.0, 5.0, 100.0}, {0.0, 0.0, -1.0}, ground);
  ASSERT_TRUE(x.has_value());
  EXPECT_LT((*x - Eigen::Vector3d(3.0, 5.0, 40.0)).norm(), 2e-3);
  EXPECT_TRUE(IntersectSurface({3.0, 5.0, 100.0}, {1.0, 0.5, -1.0}, ground).has_value());
}

TEST(GroundSurface, ARidgeHidesWhatLiesBehindIt) {
  const GriddedGround ground = Grid([](double x, double) { return std::abs(x) < 15.0 ? 100.0 : 0.0; });
  // Would reach x = 100 on the plain, but meets the ridge's flank first.
  const auto x = IntersectSurface({-190.0, 0.0, 145.0}, {290.0, 0.0, -145.0}, ground);
  ASSERT_TRUE(x.has_value());
  EXPECT_GT(x->x(), -20.0);
  EXPECT_LT(x->x(), -10.0);
  EXPECT_GT(x->z(), 40.0);
}

TEST(GroundSurface, RaysAboveTheHorizonBelowGroundOrBesideTheGridMeetNothing) {
  const GriddedGround ground = Grid([](double x, double) { return 0.1 * x; });
  const LevelGround level(10.0);
  EXPECT_FALSE(IntersectSurface({0.0, 0.0, 100.0}, {1.0, 0.0, 0.0}, level).has_value());
  EXPECT_FALSE(IntersectSurface({0.0, 0.0, 100.0}, {1.0, 0.0, 0.2}, ground).has_value());
  EXPECT_FALSE(IntersectSurface({0.0, 0.0, 9.0}, {0.0, 0.0, -1.0}, level).has_value());
  EXPECT_FALSE(IntersectSurface({100.0, 0.0, 5.0}, {0.0, 0.0, -1.0}, ground).has_value());
  EXPECT_FALSE(IntersectSurface({0.0, 0.0, 100.0}, {10.0, 0.0, -1.0}, ground).has_value());
}

TEST(GroundSurface, PixelsOfACameraOverLevelGroundAgreeWithTheGroundPlane) {
  CameraPose pose;
  pose.position_m = {12.0, -7.0, 420.0};
  pose.yaw_rad = 0.7;
  pose.pitch_rad = -1.0;
  pose.roll_rad = 0.05;
  const CameraIntrinsics intrinsics{640, 480, 900.0};
  for (const Eigen::Vector2d& u : {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(500.0, 100.0), Eigen::Vector2d(319.5, 479.5)}) {
    const auto plane = IntersectGround(pose, intrinsics, 20.0, u);
    const auto surface = IntersectSurface(pose, intrinsics, LevelGround(20.0), u);
    ASSERT_TRUE(plane.has_value() && surface.has_value());
    EXPECT_LT((surface->head<2>() - *plane).norm(), 1e-9);
    EXPECT_EQ(surface->z(), 20.0);
  }
}

}  // namespace
}  // namespace trem
