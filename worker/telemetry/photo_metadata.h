#pragma once

#include <span>
#include <string>

#include "mosaic/base/status.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// What the EXIF and XMP blocks of an image say about its camera. Position: EXIF GPS, or XMP drone-dji (of which AbsoluteAltitude less
// RelativeAltitude is the ground's elevation at take-off). Attitude: XMP drone-dji gimbal angles; else the azimuth of GPSImgDirection, and
// no elevation. Field of view: XMP drone-dji CalibratedFocalLength (px) where it is there, else the 35 mm equivalent focal length
// (HfovOfFocal35). Time: DateTimeOriginal with its fraction and zone, in utc_us. Blocks that cannot be parsed leave their values absent.
struct PhotoMetadata {
  TelemetryRecord record;  // Absolute angles.
  std::string camera;      // Make and model.
  bool from_magnetic_north = false;
  bool field_of_view_from_crop = false;  // The image is wider than 3:2: see HfovOfFocal35.
  bool any = false;                      // There was any EXIF or XMP.
};

// kInvalidInput when the file is no image that Exiv2 knows. `width_px`, `height_px`: of the picture.
Result<PhotoMetadata> ReadPhotoMetadata(const std::string& path, int width_px, int height_px);
// The same for the bytes of a file; `name` stands in messages.
Result<PhotoMetadata> ParsePhotoMetadata(std::span<const std::uint8_t> bytes, const std::string& name, int width_px, int height_px);

}  // namespace trem
