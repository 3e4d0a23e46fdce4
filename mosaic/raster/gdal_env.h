#pragma once

#include <gdal_priv.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// Registers GDAL's drivers once per process and fixes the settings that the results and the memory bound rely on: a block cache of
// 128 MiB, no .aux.xml files beside rasters, no search for sibling files. Thread safe; everything in mosaic/raster calls it.
void InitialiseGdal();

struct GdalDatasetCloser {
  void operator()(GDALDataset* dataset) const { GDALClose(dataset); }
};
using GdalDatasetPtr = std::unique_ptr<GDALDataset, GdalDatasetCloser>;

// While one lives, GDAL's errors on this thread are kept here instead of being printed. Nest strictly, like scopes.
class GdalErrors {
 public:
  GdalErrors();
  ~GdalErrors();
  GdalErrors(const GdalErrors&) = delete;
  GdalErrors& operator=(const GdalErrors&) = delete;

  // True when GDAL reported a failure (warnings do not count).
  bool failed() const { return !failures_.empty(); }
  // The failures, joined; "GDAL gave no reason" when there are none.
  std::string Text() const;
  // "<what> <path>: <text>", kCorrupt. For files of the artefact store and others that this program wrote itself.
  Status ReadStatus(const std::string& what, const std::filesystem::path& path) const;
  // "<what> <path>: <text>"; kExhausted when the disk is full, else kFailed.
  Status WriteStatus(const std::string& what, const std::filesystem::path& path) const;

 private:
  static void Handle(CPLErr severity, CPLErrorNum number, const char* message);
  std::vector<std::string> failures_;
};

// Opens an existing raster read-only. `what` names its role in the message ("scene raster"). kNotFound when there is no such file,
// kCorrupt when GDAL cannot read it as a (Geo)TIFF.
Result<GdalDatasetPtr> OpenTiff(const std::filesystem::path& path, const std::string& what);

}  // namespace trem
