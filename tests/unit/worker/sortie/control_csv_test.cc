// Goal: a gcp.csv is read as it was meant or refused with line, column, found and expected. Method: files with one property each, and a
// manifest of four frames.
#include "worker/sortie/control_csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;
using trem::testing::TempDir;
using trem::testing::WriteFileContents;

constexpr const char* kHeader = "name,longitude_deg,latitude_deg,elevation_m,frame,x_px,y_px\n";

class ControlFile : public ::testing::Test {
 protected:
  ControlFile() {
    manifest_.set_width_px(100);
    manifest_.set_height_px(80);
    for (const char* name : {"a.png", "b.png", "1.png", "d.png"}) manifest_.add_frames()->set_name(name);
  }
  Status Attach(const std::string& rows, const std::string& held_out = "") {
    v1::Control spec;
    spec.set_path(folder_ / "gcp.csv");
    WriteFileContents(spec.path(), kHeader + rows);
    spec.set_held_out(held_out);
    return AttachControl(spec, &manifest_);
  }
  TempDir folder_;
  v1::SortieManifest manifest_;
};

TEST(ControlCsv, ReadsColumnsInAnyOrderAndIgnoresOthers) {
  const auto rows = ParseControlCsv("y_px,name,frame,remark,x_px,latitude_deg,longitude_deg,elevation_m\n7.5,\"A, B\",a.png,good,3,51,-1.5,+60\n", "gcp.csv");
  ASSERT_TRUE(rows.ok()) << rows.status().message();
  ASSERT_THAT(*rows, SizeIs(1));
  const ControlRow& row = rows->front();
  EXPECT_EQ(row.name, "A, B");
  EXPECT_EQ(row.frame, "a.png");
  EXPECT_EQ(row.longitude_deg, -1.5);
  EXPECT_EQ(row.latitude_deg, 51.0);
  EXPECT_EQ(row.elevation_m, 60.0);
  EXPECT_EQ(row.x_px, 3.0);
  EXPECT_EQ(row.y_px, 7.5);
}

TEST(ControlCsv, SaysWhatIsWrongWhere) {
  const auto message = [](const std::string& text) { return ParseControlCsv(text, "gcp.csv").status().message(); };
  EXPECT_THAT(message(""), HasSubstr("gcp.csv: is empty"));
  EXPECT_THAT(message(kHeader), HasSubstr("has a header but no rows"));
  EXPECT_THAT(message("name,longitude_deg,latitude_deg,elevation_m,frame,x_px\n"), HasSubstr("gcp.csv:1: the header lacks y_px"));
  EXPECT_THAT(message(std::string(kHeader) + "P,-1.5,51,60,a.png,3\n"), HasSubstr("gcp.csv:2: has 6 cells; expected 7"));
  EXPECT_THAT(message(std::string(kHeader) + "P,-1.5,98,60,a.png,3,4\n"),
              HasSubstr("gcp.csv:2: column latitude_deg: found '98', expected -90..90 degrees"));
  EXPECT_THAT(message(std::string(kHeader) + "P,-1.5,51,60 m,a.png,3,4\n"), HasSubstr("column elevation_m: found '60 m'"));
  EXPECT_THAT(message(std::string(kHeader) + "P,-1.5,51,60,a.png,nan,4\n"), HasSubstr("column x_px: found 'nan'"));
  EXPECT_THAT(message(std::string(kHeader) + ",-1.5,51,60,a.png,3,4\n"), HasSubstr("column name: found ''"));
}

TEST_F(ControlFile, FindsFramesByNameThenByStemThenByIndex) {
  ASSERT_TRUE(Attach("P,-1.5,51,60,b.png,3,4\nP,-1.5,51,60,d,3,4\nP,-1.5,51,60,1,3,4\nP,-1.5,51,60,3,3,4\n").ok());
  ASSERT_EQ(manifest_.control_size(), 4);
  EXPECT_EQ(manifest_.control(0).frame_index(), 1U);
  EXPECT_EQ(manifest_.control(1).frame_index(), 3U);
  EXPECT_EQ(manifest_.control(2).frame_index(), 2U) << "the frame called 1.png, not the second one";
  EXPECT_EQ(manifest_.control(3).frame_index(), 3U);
}

TEST_F(ControlFile, NotesRowsOfOtherFramesAndRefusesAFileOfThemOnly) {
  ASSERT_TRUE(Attach("P,-1.5,51,60,b.png,3,4\nQ,-1.5,51,60,z.png,3,4\n").ok());
  EXPECT_EQ(manifest_.control_size(), 1);
  ASSERT_EQ(manifest_.notes_size(), 1);
  EXPECT_THAT(manifest_.notes(0).message(), HasSubstr("1 rows are of frames that the sortie does not have: z.png (line 3)"));
  manifest_.clear_control();
  EXPECT_THAT(Attach("Q,-1.5,51,60,z.png,3,4\n").message(), HasSubstr("no row names a frame of the sortie; found z.png (line 2)"));
}

TEST_F(ControlFile, RefusesPixelsOutsideTheImageAndHeldOutPointsItDoesNotHave) {
  EXPECT_THAT(Attach("P,-1.5,51,60,b.png,103,4\n").message(), HasSubstr("gcp.csv:2: x_px, y_px: found 103"));
  EXPECT_THAT(Attach("Point1,-1.5,51,60,b.png,3,4\n", "Point1, Point2").message(), HasSubstr("control.held_out names 'Point2'"));
  EXPECT_TRUE(Attach("Point1,-1.5,51,60,b.png,3,4\n", "*").ok());
}

}  // namespace
}  // namespace trem
