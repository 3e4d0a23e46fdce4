#include "mosaic/raster/gdal_env.h"

#include <mutex>
#include <system_error>

namespace trem {
namespace {

constexpr GIntBig kBlockCacheBytes = GIntBig{128} << 20;
constexpr std::size_t kFailuresKept = 4;

bool DiskIsFull(const std::filesystem::path& path) {
  constexpr std::uintmax_t kLittleBytes = 256 * 1024;
  std::error_code error;
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
  const std::filesystem::space_info space = std::filesystem::space(folder, error);
  return !error && space.available < kLittleBytes;
}

}  // namespace

void InitialiseGdal() {
  static std::once_flag once;
  std::call_once(once, [] {
    CPLSetConfigOption("GDAL_PAM_ENABLED", "NO");
    CPLSetConfigOption("GDAL_DISABLE_READDIR_ON_OPEN", "EMPTY_DIR");
    CPLSetConfigOption("GDAL_NUM_THREADS", "1");
    GDALSetCacheMax64(kBlockCacheBytes);
    GDALAllRegister();
  });
}

GdalErrors::GdalErrors() {
  InitialiseGdal();
  CPLPushErrorHandlerEx(&GdalErrors::Handle, this);
}

GdalErrors::~GdalErrors() { CPLPopErrorHandler(); }

void GdalErrors::Handle(CPLErr severity, CPLErrorNum, const char* message) {
  if (severity < CE_Failure) return;
  auto* errors = static_cast<GdalErrors*>(CPLGetErrorHandlerUserData());
  if (errors->failures_.size() < kFailuresKept) errors->failures_.emplace_back(message);
}

std::string GdalErrors::Text() const {
  if (failures_.empty()) return "GDAL gave no reason";
  std::string text;
  for (const std::string& failure : failures_) text += (text.empty() ? "" : "; ") + failure;
  return text;
}

Status GdalErrors::ReadStatus(const std::string& what, const std::filesystem::path& path) const {
  return Corrupt(what + " " + path.string() + ": " + Text());
}

Status GdalErrors::WriteStatus(const std::string& what, const std::filesystem::path& path) const {
  const std::string text = Text();
  if (text.find("No space left") != std::string::npos || DiskIsFull(path)) {
    return Exhausted(what + " " + path.string() + ": the disk is full (" + text + "); make room and try again");
  }
  return Failed(what + " " + path.string() + ": " + text);
}

Result<GdalDatasetPtr> OpenTiff(const std::filesystem::path& path, const std::string& what) {
  GdalErrors errors;
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return NotFound(what + " " + path.string() + " does not exist");
  const char* const drivers[] = {"GTiff", nullptr};
  GdalDatasetPtr dataset(static_cast<GDALDataset*>(GDALOpenEx(path.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, drivers, nullptr, nullptr)));
  if (!dataset) return errors.ReadStatus(what, path);
  return dataset;
}

}  // namespace trem
