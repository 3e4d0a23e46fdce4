// Goal: telemetry.csv is read as formats.md states it, and everything that is not so is refused with file, line, column, what was found
// and what was expected. Method: small texts.
#include "worker/sortie/telemetry_csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace trem {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kHeader = "frame,time_s,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg\n";

std::string ErrorOf(const std::string& text) {
  const auto table = ParseTelemetryCsv(text, "t.csv");
  EXPECT_FALSE(table.ok());
  return table.ok() ? "" : table.status().message();
}

TEST(TelemetryCsv, ReadsPosesInAnyColumnOrder) {
  const auto table = ParseTelemetryCsv(
      "hfov_deg,frame,pitch_deg,roll_deg,yaw_deg,altitude_m,longitude_deg,latitude_deg,time_s,ground_elevation_m\n"
      "20,f1.png,-90,1.5,350,120.5,-0.1,50.8,0.04,7\n",
      "t.csv");
  ASSERT_TRUE(table.ok()) << table.status().message();
  ASSERT_EQ(table->rows.size(), 1U);
  const TelemetryRow& row = table->rows[0];
  EXPECT_EQ(row.line, 2);
  EXPECT_EQ(row.frame, "f1.png");
  EXPECT_EQ(row.time_s, 0.04);
  EXPECT_EQ(row.ground_elevation_m, 7.0);
  ASSERT_TRUE(row.pose.has_value());
  EXPECT_EQ(row.pose->latitude_deg, 50.8);
  EXPECT_EQ(row.pose->longitude_deg, -0.1);
  EXPECT_EQ(row.pose->altitude_m, 120.5);
  EXPECT_EQ(row.pose->yaw_deg, 350.0);
  EXPECT_EQ(row.pose->pitch_deg, -90.0);
  EXPECT_EQ(row.pose->roll_deg, 1.5);
  EXPECT_EQ(row.pose->hfov_deg, 20.0);
  EXPECT_FALSE(row.pose->vfov_deg.has_value());
  EXPECT_THAT(table->warnings, IsEmpty());
}

TEST(TelemetryCsv, AcceptsByteOrderMarkCrLfQuotesBlanksAndEmptyLines) {
  const auto table = ParseTelemetryCsv(std::string("\xef\xbb\xbf") +
                                           "\"frame\",time_s,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg\r\n"
                                           "\"a \"\"b\"\",1.png\", 1 ,50,1,100,0,-45,+2,30\r\n\r\n"
                                           "c.png,,50,1,100,0,-45,0,30",
                                       "t.csv");
  ASSERT_TRUE(table.ok()) << table.status().message();
  ASSERT_EQ(table->rows.size(), 2U);
  EXPECT_EQ(table->rows[0].frame, "a \"b\",1.png");
  EXPECT_EQ(table->rows[0].time_s, 1.0);
  EXPECT_EQ(table->rows[0].pose->roll_deg, 2.0);
  EXPECT_FALSE(table->rows[1].time_s.has_value());
  EXPECT_EQ(table->rows[1].line, 4);
}

TEST(TelemetryCsv, ReadsCornersAsLongitudeLatitudePairs) {
  const auto table = ParseTelemetryCsv(
      "frame,corner_ul_lat_deg,corner_ul_lon_deg,corner_ur_lat_deg,corner_ur_lon_deg,corner_lr_lat_deg,corner_lr_lon_deg,"
      "corner_ll_lat_deg,corner_ll_lon_deg\n0,1,2,3,4,5,6,7,8\n",
      "t.csv");
  ASSERT_TRUE(table.ok()) << table.status().message();
  EXPECT_FALSE(table->has_pose);
  ASSERT_TRUE(table->rows[0].corners.has_value());
  EXPECT_THAT(*table->rows[0].corners, ElementsAre(2, 1, 4, 3, 6, 5, 8, 7));
}

TEST(TelemetryCsv, LeavesThePoseOutWhenACellIsEmpty) {
  const auto table = ParseTelemetryCsv(std::string(kHeader) + "a,0,50,1,,0,-45,0,30\n", "t.csv");
  ASSERT_TRUE(table.ok());
  EXPECT_FALSE(table->rows[0].pose.has_value());
}

TEST(TelemetryCsv, ReportsUnknownColumns) {
  const auto table = ParseTelemetryCsv(
      "speed,frame,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,vfov_deg\n9,a,0,0,1,0,-90,0,30\n", "t.csv");
  ASSERT_TRUE(table.ok()) << table.status().message();
  EXPECT_THAT(table->unknown_columns, ElementsAre("speed"));
  EXPECT_EQ(table->rows[0].pose->vfov_deg, 30.0);
}

TEST(TelemetryCsv, ListsMissingColumnsWithWhatTheyMayBeCalled) {
  const std::string error = ErrorOf("frame,latitude_deg,longitude_deg,altitude_m,yaw_degs,pitch_deg,roll_deg\na,0,0,0,0,0,0\n");
  EXPECT_THAT(error, HasSubstr("t.csv:1: the header lacks yaw_deg (did you mean it by 'yaw_degs'?), hfov_deg;"));
  EXPECT_THAT(ErrorOf("x,y\n1,2\n"), HasSubstr("lacks frame, latitude_deg"));
  EXPECT_THAT(ErrorOf("frame,corner_ul_lat_deg\na,1\n"), HasSubstr("lacks corner_ul_lon_deg, corner_ur_lat_deg"));
  EXPECT_THAT(ErrorOf(""), HasSubstr("is empty"));
  EXPECT_THAT(ErrorOf(kHeader), HasSubstr("no rows"));
  EXPECT_THAT(ErrorOf("frame,frame\n"), HasSubstr("appears twice"));
}

TEST(TelemetryCsv, NamesLineColumnValueAndRangeOfABadValue) {
  const std::string header = kHeader;
  EXPECT_EQ(ErrorOf(header + "a,0,50,1,100,0,-45,0,30\nb,0,91,1,100,0,-45,0,30\n"),
            "t.csv:3: column latitude_deg: found '91', expected -90..90 degrees");
  EXPECT_THAT(ErrorOf(header + "a,0,50,181,100,0,-45,0,30\n"), HasSubstr("column longitude_deg: found '181'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1,100,0,-91,0,30\n"), HasSubstr("column pitch_deg: found '-91'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1,100,0,-45,0,180\n"), HasSubstr("column hfov_deg: found '180'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1,100,0,-45,0,0\n"), HasSubstr("column hfov_deg: found '0'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1,nan,0,-45,0,30\n"), HasSubstr("column altitude_m: found 'nan', expected a finite number"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1,1e999,0,-45,0,30\n"), HasSubstr("found '1e999'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50N,1,100,0,-45,0,30\n"), HasSubstr("found '50N'"));
  EXPECT_THAT(ErrorOf(header + "a,0,50,1\n"), HasSubstr("t.csv:2: has 4 cells; expected 9"));
  EXPECT_THAT(ErrorOf(header + ",0,50,1,100,0,-45,0,30\n"), HasSubstr("column frame: is empty"));
  EXPECT_THAT(ErrorOf(header + "\"a,0\n"), HasSubstr("t.csv:2: a quoted field is never closed"));
  EXPECT_THAT(ErrorOf(header + "\"a\"b,0\n"), HasSubstr("text after a closing quote"));
}

TEST(TelemetryCsv, WarnsOfRadiansAndOfALookAboveTheHorizon) {
  const auto radians = ParseTelemetryCsv(std::string(kHeader) + "a,0,50,1,100,1.2,-1.57,0,0.35\n", "t.csv");
  ASSERT_TRUE(radians.ok());
  EXPECT_THAT(radians->warnings, ElementsAre(HasSubstr("radians")));
  const auto above = ParseTelemetryCsv(std::string(kHeader) + "a,0,50,1,100,1.2,5,0,35\n", "t.csv");
  ASSERT_TRUE(above.ok());
  EXPECT_THAT(above->warnings, ElementsAre(HasSubstr("t.csv:2: column pitch_deg: the camera looks above the horizon")));
}

TEST(TelemetryCsv, RefusesMoreColumnsThanItsLimit) {
  std::string header = "frame";
  for (std::size_t i = 0; i < kTelemetryColumnsMax; ++i) header += ",c" + std::to_string(i);
  EXPECT_THAT(ErrorOf(header + "\n"), HasSubstr("more than 64 columns"));
}

}  // namespace
}  // namespace trem
