// Goal: EXIF and XMP of photographs, with and without a gimbal, are read; damaged ones leave their values absent. Method: a tiny JPEG to
// which Exiv2 writes the metadata; the shared photographs where they are present.
#include "worker/telemetry/photo_metadata.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <exiv2/exiv2.hpp>

#include "tests/support/paths.h"
#include "worker/telemetry/text_scan.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

// Start and end of image: the smallest JPEG that Exiv2 takes metadata into.
constexpr std::uint8_t kEmptyJpeg[] = {0xff, 0xd8, 0xff, 0xd9};

std::vector<std::uint8_t> WithMetadata(const Exiv2::ExifData& exif, const Exiv2::XmpData& xmp) {
  Exiv2::Image::AutoPtr image = Exiv2::ImageFactory::open(kEmptyJpeg, sizeof(kEmptyJpeg));
  image->setExifData(exif);
  image->setXmpData(xmp);
  image->writeMetadata();
  Exiv2::BasicIo& io = image->io();
  io.open();
  const Exiv2::DataBuf buffer = io.read(static_cast<long>(io.size()));
  return {buffer.pData_, buffer.pData_ + buffer.size_};
}

Exiv2::ExifData Gps() {
  Exiv2::ExifData exif;
  exif["Exif.Image.Model"] = "Camera";
  exif["Exif.GPSInfo.GPSLatitudeRef"] = "S";
  exif["Exif.GPSInfo.GPSLatitude"] = "46/1 50/1 339859/10000";
  exif["Exif.GPSInfo.GPSLongitudeRef"] = "W";
  exif["Exif.GPSInfo.GPSLongitude"] = "91/1 59/1 377734/10000";
  exif["Exif.GPSInfo.GPSAltitudeRef"] = "0";
  exif["Exif.GPSInfo.GPSAltitude"] = "198509/1000";
  exif["Exif.Photo.DateTimeOriginal"] = "2016:06:23 16:32:50";
  exif["Exif.Photo.SubSecTimeOriginal"] = "25";
  exif["Exif.Photo.FocalLengthIn35mmFilm"] = std::uint16_t{20};
  return exif;
}

TEST(PhotoMetadata, PlainExifGivesPlaceTimeFieldOfViewAndDirection) {
  Exiv2::ExifData exif = Gps();
  exif["Exif.GPSInfo.GPSImgDirection"] = "1234/10";
  exif["Exif.GPSInfo.GPSImgDirectionRef"] = "M";
  const auto metadata = ParsePhotoMetadata(WithMetadata(exif, {}), "a.jpg", 4000, 3000);
  ASSERT_TRUE(metadata.ok()) << metadata.status().message();
  const TelemetryRecord& record = metadata->record;
  EXPECT_NEAR(record.sensor->latitude_deg, -(46.0 + 50.0 / 60.0 + 33.9859 / 3600.0), 1e-9);
  EXPECT_NEAR(record.sensor->longitude_deg, -(91.0 + 59.0 / 60.0 + 37.7734 / 3600.0), 1e-9);
  EXPECT_NEAR(*record.altitude_msl_m, 198.509, 1e-9);
  EXPECT_EQ(record.utc_us, *ParseTimeUtc("2016-06-23T16:32:50Z") + 250'000);
  EXPECT_NEAR(*record.hfov_deg, HfovOfFocal35(20.0, 4.0 / 3.0), 1e-9);
  EXPECT_NEAR(*record.sensor_azimuth_deg, 123.4, 1e-9);
  EXPECT_TRUE(metadata->from_magnetic_north);
  EXPECT_FALSE(record.HasPointing());
  EXPECT_FALSE(record.centre_elevation_msl_m.has_value());
}

TEST(PhotoMetadata, DjiXmpGivesTheGimbalTheGroundAndACalibratedFocalLength) {
  Exiv2::XmpProperties::registerNs("http://www.dji.com/drone-dji/1.0/", "drone-dji");
  Exiv2::XmpData xmp;
  xmp["Xmp.drone-dji.AbsoluteAltitude"] = "+198.51";
  xmp["Xmp.drone-dji.RelativeAltitude"] = "+40.00";
  xmp["Xmp.drone-dji.GimbalYawDegree"] = "-132.00";
  xmp["Xmp.drone-dji.GimbalPitchDegree"] = "-89.90";
  xmp["Xmp.drone-dji.GimbalRollDegree"] = "+0.00";
  xmp["Xmp.drone-dji.CalibratedFocalLength"] = "2000";
  const auto metadata = ParsePhotoMetadata(WithMetadata(Gps(), xmp), "a.jpg", 4000, 3000);
  ASSERT_TRUE(metadata.ok()) << metadata.status().message();
  EXPECT_NEAR(*metadata->record.centre_elevation_msl_m, 158.51, 1e-9);
  EXPECT_EQ(metadata->record.sensor_azimuth_deg, -132.0);
  EXPECT_EQ(metadata->record.sensor_elevation_deg, -89.9);
  EXPECT_NEAR(*metadata->record.hfov_deg, 90.0, 1e-9);
}

TEST(PhotoMetadata, DamageLeavesValuesAbsent) {
  Exiv2::ExifData exif = Gps();
  exif["Exif.GPSInfo.GPSLatitude"] = "46/0 50/1 0/1";
  const auto metadata = ParsePhotoMetadata(WithMetadata(exif, {}), "a.jpg", 4000, 3000);
  ASSERT_TRUE(metadata.ok());
  EXPECT_FALSE(metadata->record.sensor.has_value());
  std::vector<std::uint8_t> cut = WithMetadata(Gps(), {});
  cut.resize(cut.size() / 2);
  const auto damaged = ParsePhotoMetadata(cut, "a.jpg", 4000, 3000);
  EXPECT_TRUE(!damaged.ok() || !damaged->record.sensor.has_value());
  const std::uint8_t text[] = {'n', 'o', ' ', 'i', 'm', 'a', 'g', 'e'};
  const auto none = ParsePhotoMetadata(text, "b.jpg", 40, 30);
  ASSERT_FALSE(none.ok());
  EXPECT_THAT(none.status().message(), HasSubstr("b.jpg"));
}

TEST(PhotoMetadata, ReadsTheSharedPhotographs) {
  const auto data = testing::TestDataDir();
  if (!data.has_value()) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)";
  const auto metadata = ReadPhotoMetadata((*data / "exif/DJI_0026.JPG").string(), 4000, 2250);
  ASSERT_TRUE(metadata.ok()) << metadata.status().message();
  EXPECT_NEAR(metadata->record.sensor->latitude_deg, 46.8426903, 1e-6);
  EXPECT_NEAR(metadata->record.sensor->longitude_deg, -91.9939544, 1e-6);
  EXPECT_NEAR(*metadata->record.altitude_msl_m - *metadata->record.centre_elevation_msl_m, 40.1, 1e-6);
  EXPECT_NEAR(*metadata->record.sensor_azimuth_deg, -132.0, 1e-9);
  EXPECT_TRUE(metadata->field_of_view_from_crop);
}

}  // namespace
}  // namespace trem
