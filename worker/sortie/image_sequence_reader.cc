#include "worker/sortie/image_sequence_reader.h"

#include <cpl_conv.h>
#include <cpl_error.h>
#include <gdal.h>
#include <glob.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <fstream>
#include <memory>
#include <mutex>

namespace trem {
namespace {

constexpr std::size_t kImageCountMax = 10'000'000;

bool IsDigit(char c) { return c >= '0' && c <= '9'; }

// The run of digits of `text` that starts at `begin`; advances `begin` behind it and leaves leading zeros out.
std::string_view TakeNumber(std::string_view text, std::size_t* begin) {
  std::size_t end = *begin;
  while (end < text.size() && IsDigit(text[end])) ++end;
  std::size_t first = *begin;
  while (first + 1 < end && text[first] == '0') ++first;
  *begin = end;
  return text.substr(first, end - first);
}

bool HasWildcard(const std::string& text) { return text.find_first_of("*?[") != std::string::npos; }

// Remembers what GDAL and its libraries complain about while it is alive.
class GdalMessages {
 public:
  GdalMessages() { CPLPushErrorHandlerEx(&GdalMessages::Collect, this); }
  ~GdalMessages() { CPLPopErrorHandler(); }
  GdalMessages(const GdalMessages&) = delete;
  GdalMessages& operator=(const GdalMessages&) = delete;

  const std::string& first() const { return first_; }
  bool truncated() const { return truncated_; }

 private:
  static void CPL_STDCALL Collect(CPLErr severity, CPLErrorNum, const char* message) {
    auto* self = static_cast<GdalMessages*>(CPLGetErrorHandlerUserData());
    const std::string text = message == nullptr ? "" : message;
    // libjpeg fills a truncated image with grey and only warns.
    if (text.find("remature end") != std::string::npos) self->truncated_ = true;
    if (severity >= CE_Failure || self->truncated_) {
      if (self->first_.empty()) self->first_ = text;
    }
  }

  std::string first_;
  bool truncated_ = false;
};

struct DatasetCloser {
  void operator()(GDALDatasetH dataset) const { GDALClose(dataset); }
};
using DatasetPtr = std::unique_ptr<void, DatasetCloser>;

void RegisterDrivers() {
  static std::once_flag once;
  std::call_once(once, [] { GDALAllRegister(); });
}

// The first bytes of a file as printable text, for messages.
std::string Beginning(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  char bytes[12] = {};
  file.read(bytes, sizeof(bytes) - 1);
  std::string text(bytes, static_cast<std::size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  for (char& c : text) {
    if (std::isprint(static_cast<unsigned char>(c)) == 0) c = '.';
  }
  return text;
}

Status NotAnImage(const std::filesystem::path& path, const std::string& detail) {
  std::error_code error;
  const auto bytes = std::filesystem::file_size(path, error);
  if (error) return FromErrno(path.string(), error.value());
  const std::string found = bytes == 0 ? "the file is empty" : "begins with '" + Beginning(path) + "'";
  return InvalidInput(path.string() + ": not an image that can be decoded (" + found + (detail.empty() ? "" : "; " + detail) +
                      "); expected PNG, TIFF or JPEG");
}

ImageSize SizeOf(GDALDatasetH dataset) { return {GDALGetRasterXSize(dataset), GDALGetRasterYSize(dataset)}; }

Result<DatasetPtr> OpenDataset(const std::filesystem::path& path, const GdalMessages& messages) {
  RegisterDrivers();
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return NotFound(path.string() + ": no such file");
  const char* const drivers[] = {"PNG", "JPEG", "GTiff", nullptr};
  // The list of siblings is empty: no .aux.xml, .ovr or world file may change what a frame is.
  const char* const siblings[] = {nullptr};
  DatasetPtr dataset(GDALOpenEx(path.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, drivers, nullptr, siblings));
  if (dataset == nullptr || GDALGetRasterCount(dataset.get()) < 1) return NotAnImage(path, messages.first());
  const ImageSize size = SizeOf(dataset.get());
  if (size.width_px > kImageSideMax_px || size.height_px > kImageSideMax_px ||
      static_cast<long long>(size.width_px) * size.height_px > kImageAreaMax_px) {
    return InvalidInput(path.string() + ": is " + std::to_string(size.width_px) + " x " + std::to_string(size.height_px) +
                        " pixels; expected at most " + std::to_string(kImageSideMax_px) + " a side and " +
                        std::to_string(kImageAreaMax_px / 1'000'000) + " megapixels");
  }
  return dataset;
}

double GreyMax(GDALDataType type) {
  if (type == GDT_Byte) return 255.0;
  if (type == GDT_UInt16) return 65535.0;
  return 0.0;
}

Status ReadBand(GDALDatasetH dataset, int band, Image<float>* pixels) {
  const CPLErr error = GDALRasterIO(GDALGetRasterBand(dataset, band), GF_Read, 0, 0, pixels->width(), pixels->height(), pixels->row(0),
                                    pixels->width(), pixels->height(), GDT_Float32, 0, 0);
  if (error != CE_None) return Failed("band " + std::to_string(band));
  return {};
}

// Replaces palette indices by the luminance of their colours.
void ApplyPalette(GDALColorTableH table, Image<float>* pixels) {
  const int count = GDALGetColorEntryCount(table);
  std::vector<float> luminance(static_cast<std::size_t>(std::max(count, 1)), 0.0F);
  for (int i = 0; i < count; ++i) {
    const GDALColorEntry* entry = GDALGetColorEntry(table, i);
    luminance[static_cast<std::size_t>(i)] =
        Luminance(static_cast<float>(entry->c1), static_cast<float>(entry->c2), static_cast<float>(entry->c3));
  }
  for (float& value : pixels->pixels()) {
    value = luminance[static_cast<std::size_t>(std::clamp(static_cast<int>(value), 0, static_cast<int>(luminance.size()) - 1))];
  }
}

Status ReadPixels(GDALDatasetH dataset, Image<float>* grey) {
  TREM_RETURN_IF_ERROR(ReadBand(dataset, 1, grey));
  const int bands = GDALGetRasterCount(dataset);
  GDALColorTableH palette = GDALGetRasterColorTable(GDALGetRasterBand(dataset, 1));
  if (palette != nullptr) {
    ApplyPalette(palette, grey);
    return {};
  }
  if (bands < 3) return {};
  Image<float> green(grey->width(), grey->height());
  Image<float> blue(grey->width(), grey->height());
  TREM_RETURN_IF_ERROR(ReadBand(dataset, 2, &green));
  TREM_RETURN_IF_ERROR(ReadBand(dataset, 3, &blue));
  const auto out = grey->pixels();
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = Luminance(out[i], green.pixels()[i], blue.pixels()[i]);
  return {};
}

Status FolderProblem(const std::filesystem::path& folder, std::size_t other_count, const std::string& example) {
  return InvalidInput(folder.string() + ": holds no image (" + std::to_string(other_count) + " other files" +
                      (example.empty() ? "" : ", for example '" + example + "'") + "); expected .png, .tif, .tiff, .jpg or .jpeg files");
}

Result<ImageList> ListFolder(const std::filesystem::path& folder) {
  ImageList list;
  list.folder = folder;
  std::size_t other_count = 0;
  std::string example;
  std::error_code error;
  std::filesystem::directory_iterator iterator(folder, error);
  if (error) return FromErrno(folder.string(), error.value());
  for (const auto& entry : iterator) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with('.') || entry.is_directory(error)) continue;
    if (HasImageExtension(entry.path())) {
      list.names.push_back(name);
      if (list.names.size() > kImageCountMax) {
        return Exhausted(folder.string() + ": holds more than " + std::to_string(kImageCountMax) + " images; split the sortie");
      }
    } else {
      ++other_count;
      if (example.empty() || name < example) example = name;
    }
  }
  if (list.names.empty()) return FolderProblem(folder, other_count, example);
  return list;
}

Result<ImageList> ListGlob(const std::string& pattern) {
  ImageList list;
  list.folder = ImageFolder(pattern);
  glob_t matches{};
  const int outcome = glob(pattern.c_str(), 0, nullptr, &matches);
  const std::unique_ptr<glob_t, void (*)(glob_t*)> free_matches(&matches, &globfree);
  if (outcome == GLOB_NOMATCH) return NotFound(pattern + ": matches no file");
  if (outcome != 0) return Failed(pattern + ": cannot be expanded (glob error " + std::to_string(outcome) + ")");
  std::size_t other_count = 0;
  std::string example;
  for (std::size_t i = 0; i < matches.gl_pathc; ++i) {
    const std::filesystem::path path = matches.gl_pathv[i];
    if (HasImageExtension(path)) {
      list.names.push_back(path.lexically_relative(list.folder).string());
    } else if (++other_count == 1) {
      example = path.filename().string();
    }
  }
  if (list.names.empty()) return FolderProblem(pattern, other_count, example);
  return list;
}

}  // namespace

bool NaturalLess(std::string_view a, std::string_view b) {
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (IsDigit(a[i]) && IsDigit(b[j])) {
      const std::string_view number_a = TakeNumber(a, &i);
      const std::string_view number_b = TakeNumber(b, &j);
      if (number_a.size() != number_b.size()) return number_a.size() < number_b.size();
      if (number_a != number_b) return number_a < number_b;
      continue;
    }
    if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
    ++i;
    ++j;
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;  // "7" and "07": any fixed order will do.
}

bool HasImageExtension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension == ".png" || extension == ".tif" || extension == ".tiff" || extension == ".jpg" || extension == ".jpeg";
}

bool IsGlob(const std::string& path) {
  std::error_code error;
  return HasWildcard(path) && !std::filesystem::exists(path, error);
}

std::filesystem::path ImageFolder(const std::string& source_path) {
  std::error_code error;
  if (std::filesystem::is_directory(source_path, error)) return source_path;
  const std::filesystem::path path(source_path);
  if (!IsGlob(source_path)) return path.parent_path();
  std::filesystem::path folder;
  for (const auto& part : path) {
    if (HasWildcard(part.string())) break;
    folder /= part;
  }
  return folder == path ? path.parent_path() : folder;
}

Result<ImageList> ListImages(const std::string& source_path) {
  std::error_code error;
  const std::filesystem::path path(source_path);
  if (std::filesystem::is_regular_file(path, error)) return ImageList{path.parent_path(), {path.filename().string()}};
  if (!IsGlob(source_path) && !std::filesystem::exists(path, error)) return NotFound(source_path + ": no such file or folder");
  TREM_ASSIGN_OR_RETURN(ImageList list, IsGlob(source_path) ? ListGlob(source_path) : ListFolder(path));
  std::sort(list.names.begin(), list.names.end(), [](const std::string& a, const std::string& b) { return NaturalLess(a, b); });
  return list;
}

Result<ImageSize> ReadImageSize(const std::filesystem::path& path) {
  const GdalMessages messages;
  TREM_ASSIGN_OR_RETURN(const DatasetPtr dataset, OpenDataset(path, messages));
  return SizeOf(dataset.get());
}

Result<std::string> ReadImageMetadata(const std::filesystem::path& path, const std::string& key) {
  const GdalMessages messages;
  TREM_ASSIGN_OR_RETURN(const DatasetPtr dataset, OpenDataset(path, messages));
  const int bands = GDALGetRasterCount(dataset.get());
  if (bands != 1) return InvalidInput(path.string() + ": has " + std::to_string(bands) + " bands; expected one");
  const char* value = GDALGetMetadataItem(dataset.get(), key.c_str(), nullptr);
  return std::string(value == nullptr ? "" : value);
}

Result<GreyImage> ReadGreyImage(const std::filesystem::path& path) {
  const GdalMessages messages;
  TREM_ASSIGN_OR_RETURN(const DatasetPtr dataset, OpenDataset(path, messages));
  const ImageSize size = SizeOf(dataset.get());
  GreyImage image;
  image.pixels = Image<float>(size.width_px, size.height_px);
  image.grey_max = GreyMax(GDALGetRasterDataType(GDALGetRasterBand(dataset.get(), 1)));
  const Status status = ReadPixels(dataset.get(), &image.pixels);
  if (!status.ok() || messages.truncated()) {
    return InvalidInput(path.string() + ": the image is damaged or cut short (" + messages.first() + ")");
  }
  const auto is_finite = [](float value) { return std::isfinite(value); };
  if (image.grey_max == 0.0 && !std::all_of(image.pixels.pixels().begin(), image.pixels.pixels().end(), is_finite)) {
    return InvalidInput(path.string() + ": holds pixels that are not finite numbers; expected intensities");
  }
  return image;
}

}  // namespace trem
