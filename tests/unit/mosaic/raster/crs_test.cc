// Goal: coordinates on Earth become metres on a map the way PROJ says, in GIS axis order, and unusable CRSs are refused by name.
// Method: published example points, closed forms of the transverse Mercator projection, round trips.
#include "mosaic/raster/crs.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace trem {
namespace {

using ::testing::HasSubstr;

TEST(UtmEpsg, FollowsZonesOfSixDegreesAndTheHemisphere) {
  EXPECT_EQ(UtmEpsg(50.83, -0.14), 32630);
  EXPECT_EQ(UtmEpsg(50.83, 0.0), 32631);
  EXPECT_EQ(UtmEpsg(-33.9, 151.2), 32756);
  EXPECT_EQ(UtmEpsg(0.0, -180.0), 32601);
  EXPECT_EQ(UtmEpsg(0.0, 179.999), 32660);
  EXPECT_EQ(UtmEpsg(0.0, 180.0), 32601) << "180 E is 180 W";
}

TEST(UtmFrame, PutsTheCentralMeridianAt500KilometresWithScale0p9996AndNoConvergence) {
  const auto frame = UtmFrame::ForPoint(45.0, 9.0);
  ASSERT_TRUE(frame.ok()) << frame.status().ToString();
  const auto x = frame->Forward(45.0, 9.0);
  ASSERT_TRUE(x.ok());
  EXPECT_NEAR(x->x(), 500000.0, 1e-6);
  EXPECT_NEAR(x->y(), 4982950.400, 1e-2);  // Meridian arc to 45 N on WGS 84, 4984944.378 m, times 0.9996.
  EXPECT_NEAR(*frame->ConvergenceRad(45.0, 9.0), 0.0, 1e-9);
  EXPECT_NEAR(*frame->ScaleFactor(45.0, 9.0), 0.9996, 1e-7);
}

TEST(UtmFrame, GivesTheSouthernHemisphereItsFalseNorthing) {
  const auto frame = UtmFrame::ForPoint(-33.9, 151.2);
  ASSERT_TRUE(frame.ok());
  const auto x = frame->Forward(-33.9, 151.2);
  ASSERT_TRUE(x.ok());
  EXPECT_GT(x->y(), 6.0e6);
  EXPECT_LT(x->y(), 6.5e6);
  EXPECT_GT(x->x(), 3.0e5);
}

TEST(UtmFrame, ConvergenceIsPositiveEastOfTheCentralMeridianInTheNorth) {
  const auto frame = UtmFrame::ForCrs("EPSG:32630");
  ASSERT_TRUE(frame.ok());
  const double latitude_deg = 50.8;
  const double east_of_meridian_rad = 2.5 * std::numbers::pi / 180.0;
  const double expected = std::atan(std::tan(east_of_meridian_rad) * std::sin(latitude_deg * std::numbers::pi / 180.0));  // Spherical form.
  EXPECT_NEAR(*frame->ConvergenceRad(latitude_deg, -0.5), expected, 2e-5);
  EXPECT_NEAR(*frame->ConvergenceRad(latitude_deg, -5.5), -expected, 2e-5);
  EXPECT_NEAR(*frame->ConvergenceRad(-latitude_deg, -0.5), -expected, 2e-5);
}

TEST(UtmFrame, RoundTripsWithinAMillimetre) {
  for (const char* crs : {"EPSG:32630", "EPSG:27700", "EPSG:3857"}) {
    const auto frame = UtmFrame::ForCrs(crs);
    ASSERT_TRUE(frame.ok()) << frame.status().ToString();
    const auto x = frame->Forward(50.83, -0.14);
    ASSERT_TRUE(x.ok());
    const auto back = frame->Inverse(*x);
    ASSERT_TRUE(back.ok());
    constexpr double kMetresPerDegree = 111320.0;
    EXPECT_NEAR((back->x() - 50.83) * kMetresPerDegree, 0.0, 1e-3) << crs;
    EXPECT_NEAR((back->y() + 0.14) * kMetresPerDegree * std::cos(50.83 * std::numbers::pi / 180.0), 0.0, 1e-3) << crs;
  }
}

TEST(UtmFrame, KeepsXEastForACrsWhoseAuthorityPutsNorthingFirst) {
  const auto frame = UtmFrame::ForCrs("EPSG:31467");  // Gauss-Krueger zone 3: axes (X north, Y east) by definition.
  ASSERT_TRUE(frame.ok());
  const auto x = frame->Forward(50.0, 9.0);
  ASSERT_TRUE(x.ok());
  EXPECT_NEAR(x->x(), 3500000.0, 500.0);
  EXPECT_GT(x->y(), 5.0e6);
}

TEST(UtmFrame, RefusesGeographicUnknownAndNonMetricSystemsByName) {
  for (const char* crs : {"EPSG:4326", "EPSG:999999", "Sussex", "", "EPSG:2227", "http://127.0.0.1:1/crs", "/etc/hostname"}) {
    const auto frame = UtmFrame::ForCrs(crs);
    ASSERT_FALSE(frame.ok()) << crs;
    EXPECT_EQ(frame.status().code(), StatusCode::kInvalidInput);
    EXPECT_THAT(frame.status().message(), HasSubstr(std::string("\"") + crs + "\""));
  }
  EXPECT_THAT(UtmFrame::ForCrs("EPSG:4326").status().message(), HasSubstr("geographic"));
}

TEST(UtmFrame, RefusesPointsThatAreNotOnEarth) {
  EXPECT_FALSE(UtmFrame::ForPoint(91.0, 0.0).ok());
  EXPECT_FALSE(UtmFrame::ForPoint(std::nan(""), 0.0).ok());
  const auto frame = UtmFrame::ForCrs("EPSG:32630");
  ASSERT_TRUE(frame.ok());
  EXPECT_FALSE(frame->Forward(std::nan(""), 0.0).ok());
}

TEST(CrsWkt, NamesTheSystemAndTheLocalOneParses) {
  const auto wkt = CrsWkt("EPSG:32630");
  ASSERT_TRUE(wkt.ok());
  EXPECT_THAT(*wkt, HasSubstr("UTM zone 30N"));
  const auto local = CrsWkt(LocalPixelCrsWkt());
  ASSERT_TRUE(local.ok()) << local.status().ToString();
  EXPECT_THAT(*local, HasSubstr("local, sensor pixels"));
}

}  // namespace
}  // namespace trem
