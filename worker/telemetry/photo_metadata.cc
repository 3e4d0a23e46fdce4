#include "worker/telemetry/photo_metadata.h"

#include <cmath>
#include <exiv2/exiv2.hpp>
#include <mutex>
#include <numbers>

#include "worker/telemetry/text_scan.h"

namespace trem {
namespace {

// Exiv2 prints to stderr; what matters of it reaches the user by way of our own messages.
void QuietExiv2() {
  static std::once_flag once;
  std::call_once(once, [] {
    Exiv2::LogMsg::setLevel(Exiv2::LogMsg::mute);
    Exiv2::XmpParser::initialize();
  });
}

class Reader {
 public:
  Reader(const Exiv2::ExifData& exif, const Exiv2::XmpData& xmp, int width_px, int height_px)
      : exif_(exif), xmp_(xmp), width_px_(width_px), height_px_(height_px) {}

  PhotoMetadata Read() {
    result_.any = !exif_.empty() || !xmp_.empty();
    result_.camera = Text("Exif.Image.Make") + (Text("Exif.Image.Make").empty() ? "" : " ") + Text("Exif.Image.Model");
    ReadPlace();
    ReadAttitude();
    ReadFieldOfView();
    ReadTime();
    return result_;
  }

 private:
  std::string Text(const char* key) const {
    const auto found = exif_.findKey(Exiv2::ExifKey(key));
    if (found == exif_.end() || found->size() > 256) return "";
    std::string text = found->toString();
    while (!text.empty() && (text.back() == '\0' || text.back() == ' ')) text.pop_back();
    for (char& c : text) {
      if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f) c = '?';
    }
    return text;
  }

  // Component `index` of a number; rationals with a denominator of 0 are none.
  std::optional<double> Number(const char* key, long index = 0) const {
    const auto found = exif_.findKey(Exiv2::ExifKey(key));
    if (found == exif_.end() || found->count() <= index) return std::nullopt;
    const Exiv2::Rational rational = found->toRational(index);
    if (rational.second == 0) return std::nullopt;
    return static_cast<double>(rational.first) / rational.second;
  }

  // As an unsigned rational: Exiv2's toRational would wrap large numerators.
  std::optional<double> Degrees(const char* key, const char* reference_key, char negative) const {
    const auto found = exif_.findKey(Exiv2::ExifKey(key));
    if (found == exif_.end() || found->count() != 3) return std::nullopt;
    double degrees = 0.0;
    for (long i = 0; i < 3; ++i) {
      const std::optional<double> part = Number(key, i);
      if (!part.has_value() || *part < 0.0) return std::nullopt;
      degrees += *part / std::pow(60.0, static_cast<double>(i));
    }
    const std::string reference = Text(reference_key);
    return !reference.empty() && reference[0] == negative ? -degrees : degrees;
  }

  std::optional<double> Dji(const std::string& name) const {
    try {
      const auto found = xmp_.findKey(Exiv2::XmpKey("Xmp.drone-dji." + name));
      if (found == xmp_.end()) return std::nullopt;
      return ParseDecimal(found->toString());
    } catch (const Exiv2::AnyError&) {
      // The file declares no such namespace.
      return std::nullopt;
    }
  }

  void ReadPlace() {
    TelemetryRecord& record = result_.record;
    std::optional<double> latitude = Degrees("Exif.GPSInfo.GPSLatitude", "Exif.GPSInfo.GPSLatitudeRef", 'S');
    std::optional<double> longitude = Degrees("Exif.GPSInfo.GPSLongitude", "Exif.GPSInfo.GPSLongitudeRef", 'W');
    if (!latitude.has_value() || !longitude.has_value()) {
      latitude = Dji("GpsLatitude");
      longitude = Dji("GpsLongitude");
      if (!longitude.has_value()) longitude = Dji("GpsLongtitude");
    }
    if (latitude.has_value() && longitude.has_value() && std::abs(*latitude) <= 90.0 && std::abs(*longitude) <= 180.0) {
      record.sensor = GeoPoint{*latitude, *longitude};
    }
    record.altitude_msl_m = Dji("AbsoluteAltitude");
    if (!record.altitude_msl_m.has_value()) {
      record.altitude_msl_m = Number("Exif.GPSInfo.GPSAltitude");
      if (record.altitude_msl_m.has_value() && Number("Exif.GPSInfo.GPSAltitudeRef") == 1.0) *record.altitude_msl_m *= -1.0;
    }
    const std::optional<double> above_takeoff = Dji("RelativeAltitude");
    if (record.altitude_msl_m.has_value() && above_takeoff.has_value())
      record.centre_elevation_msl_m = *record.altitude_msl_m - *above_takeoff;
  }

  void ReadAttitude() {
    TelemetryRecord& record = result_.record;
    record.sensor_azimuth_deg = Dji("GimbalYawDegree");
    record.sensor_elevation_deg = Dji("GimbalPitchDegree");
    record.sensor_roll_deg = Dji("GimbalRollDegree");
    if (record.sensor_elevation_deg.has_value() && std::abs(*record.sensor_elevation_deg) > 180.0) record.sensor_elevation_deg.reset();
    if (record.sensor_azimuth_deg.has_value()) return;
    record.sensor_azimuth_deg = Number("Exif.GPSInfo.GPSImgDirection");
    result_.from_magnetic_north = record.sensor_azimuth_deg.has_value() && Text("Exif.GPSInfo.GPSImgDirectionRef") == "M";
  }

  void ReadFieldOfView() {
    const std::optional<double> calibrated_px = Dji("CalibratedFocalLength");
    const std::optional<double> focal35_mm = Number("Exif.Photo.FocalLengthIn35mmFilm");
    const double aspect = static_cast<double>(width_px_) / height_px_;
    if (calibrated_px.has_value() && *calibrated_px > 0.05 * width_px_ && *calibrated_px < 1000.0 * width_px_) {
      result_.record.hfov_deg = 2.0 * std::atan(0.5 * width_px_ / *calibrated_px) * 180.0 / std::numbers::pi;
    } else if (focal35_mm.has_value() && *focal35_mm >= 1.0 && *focal35_mm <= 20000.0) {
      result_.record.hfov_deg = HfovOfFocal35(*focal35_mm, aspect);
      result_.field_of_view_from_crop = aspect > 1.52;
    }
  }

  void ReadTime() {
    const std::string time = Text("Exif.Photo.DateTimeOriginal");
    if (time.size() != 19) return;
    const std::string fraction = Text("Exif.Photo.SubSecTimeOriginal");
    result_.record.utc_us = ParseTimeUtc(time + (fraction.empty() ? "" : "." + fraction) + Text("Exif.Photo.OffsetTimeOriginal"));
    if (!result_.record.utc_us.has_value()) result_.record.utc_us = ParseTimeUtc(time);
  }

  const Exiv2::ExifData& exif_;
  const Exiv2::XmpData& xmp_;
  int width_px_;
  int height_px_;
  PhotoMetadata result_;
};

template <typename Open>
Result<PhotoMetadata> Guarded(const std::string& name, int width_px, int height_px, Open open) {
  TREM_CHECK(width_px > 0 && height_px > 0);
  QuietExiv2();
  try {
    const Exiv2::Image::AutoPtr image = open();
    if (image.get() == nullptr) return InvalidInput(name + ": is no image with metadata that can be read");
    image->readMetadata();
    return Reader(image->exifData(), image->xmpData(), width_px, height_px).Read();
  } catch (const Exiv2::AnyError& error) {
    return InvalidInput(name + ": its metadata cannot be read (" + error.what() + ")");
  } catch (const std::exception& error) {
    return InvalidInput(name + ": its metadata cannot be read (" + error.what() + ")");
  }
}

}  // namespace

Result<PhotoMetadata> ReadPhotoMetadata(const std::string& path, int width_px, int height_px) {
  return Guarded(path, width_px, height_px, [&path] { return Exiv2::ImageFactory::open(path); });
}

Result<PhotoMetadata> ParsePhotoMetadata(std::span<const std::uint8_t> bytes, const std::string& name, int width_px, int height_px) {
  return Guarded(name, width_px, height_px, [&bytes] { return Exiv2::ImageFactory::open(bytes.data(), static_cast<long>(bytes.size())); });
}

}  // namespace trem
