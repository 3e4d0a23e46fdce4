#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/sortie/grey_image.h"

namespace trem {

// "frame2" before "frame10": runs of digits compare as numbers, everything else byte by byte.
bool NaturalLess(std::string_view a, std::string_view b);

// True for the extensions of images that can be read (.png, .tif, .tiff, .jpg, .jpeg; any case).
bool HasImageExtension(const std::filesystem::path& path);

// True when `path` holds a wildcard of glob(7) and nothing of that very name exists.
bool IsGlob(const std::string& path);

// The images of a folder, of a glob, or one image file.
struct ImageList {
  std::filesystem::path folder;    // What the names are relative to.
  std::vector<std::string> names;  // In natural order.
};

// Lists the images at `source_path`. Files with other extensions are not images and are ignored. kNotFound when the folder does not
// exist or the glob matches nothing; kInvalidInput when there is no image among the files.
Result<ImageList> ListImages(const std::string& source_path);

// The folder that ListImages(source_path) would report, without looking at its contents.
std::filesystem::path ImageFolder(const std::string& source_path);

struct ImageSize {
  int width_px = 0;
  int height_px = 0;
};

// What the header says, within the limits of grey_image.h; no pixels are decoded. Same errors as ReadGreyImage.
Result<ImageSize> ReadImageSize(const std::filesystem::path& path);

// A metadata item of the file's default domain; empty when it has none. Same errors as ReadGreyImage. kInvalidInput when the image has more than one band.
Result<std::string> ReadImageMetadata(const std::filesystem::path& path, const std::string& key);

// Decodes a PNG, TIFF or JPEG with 8 or 16 bit (TIFF: any number type), grey, palette or colour; transparency is ignored. kInvalidInput
// when it is not such an image, is damaged, or is larger than the limits of grey_image.h.
Result<GreyImage> ReadGreyImage(const std::filesystem::path& path);

}  // namespace trem
