#include "worker/simulate/truth.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <system_error>

#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

constexpr long long kMaxCells = 400'000'000;

Result<GdalDatasetPtr> Open(const std::string& path) {
  InitialiseGdal();
  const GdalErrors errors;
  GdalDatasetPtr dataset(static_cast<GDALDataset*>(GDALOpenEx(path.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, nullptr, nullptr, nullptr)));
  if (!dataset) {
    std::error_code error;
    if (path.rfind("/vsi", 0) != 0 && !std::filesystem::exists(path, error)) return NotFound("truth '" + path + "': no such file");
    return InvalidInput("truth '" + path + "' is not an image that GDAL can read (" + errors.Text() + "); give a PNG, JPEG or TIFF file");
  }
  const int width = dataset->GetRasterXSize();
  const int height = dataset->GetRasterYSize();
  if (dataset->GetRasterCount() < 1) return InvalidInput("truth '" + path + "' has no raster band");
  if (static_cast<long long>(width) * height > kMaxCells) {
    return InvalidInput("truth '" + path + "' has " + std::to_string(width) + " x " + std::to_string(height) + " cells; at most " +
                        std::to_string(kMaxCells) + " can be used; crop it");
  }
  return dataset;
}

Status ReadBand(GDALDataset* dataset, int band, const std::string& path, Image<float>* image) {
  const GdalErrors errors;
  if (dataset->GetRasterBand(band)->RasterIO(GF_Read, 0, 0, image->width(), image->height(), image->row(0), image->width(), image->height(),
                                             GDT_Float32, 0, 0, nullptr) != CE_None) {
    return InvalidInput("truth '" + path + "', band " + std::to_string(band) + " cannot be read: " + errors.Text());
  }
  return {};
}

}  // namespace

Result<Image<float>> ReadGrey(const std::string& path) {
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, Open(path));
  Image<float> grey(dataset->GetRasterXSize(), dataset->GetRasterYSize());
  TREM_RETURN_IF_ERROR(ReadBand(dataset.get(), 1, path, &grey));
  if (dataset->GetRasterCount() >= 3) {
    Image<float> green(grey.width(), grey.height());
    Image<float> blue(grey.width(), grey.height());
    TREM_RETURN_IF_ERROR(ReadBand(dataset.get(), 2, path, &green));
    TREM_RETURN_IF_ERROR(ReadBand(dataset.get(), 3, path, &blue));
    for (std::size_t i = 0; i < grey.pixels().size(); ++i) {
      grey.pixels()[i] = 0.299F * grey.pixels()[i] + 0.587F * green.pixels()[i] + 0.114F * blue.pixels()[i];
    }
  }
  int has_nodata = 0;
  const auto nodata = static_cast<float>(dataset->GetRasterBand(1)->GetNoDataValue(&has_nodata));
  float low = grey.at(0, 0);
  float high = low;
  for (std::size_t i = 0; i < grey.pixels().size(); ++i) {
    const float value = grey.pixels()[i];
    if (!std::isfinite(value) || (has_nodata != 0 && value == nodata)) {
      const auto width = static_cast<std::size_t>(grey.width());
      return InvalidInput("truth '" + path + "' has no value at column " + std::to_string(i % width) + ", row " +
                          std::to_string(i / width) + "; a truth must be complete: crop or fill it");
    }
    low = std::min(low, value);
    high = std::max(high, value);
  }
  if (dataset->GetRasterBand(1)->GetRasterDataType() != GDT_Byte) {
    if (high <= low) return InvalidInput("truth '" + path + "' is one constant value; there is nothing to see");
    const float scale = 255.0F / (high - low);
    for (float& value : grey.pixels()) value = (value - low) * scale;
  }
  return grey;
}

Status WriteTruth(const Truth& truth, const std::filesystem::path& path) {
  return WriteFloatRaster(path, {{{"truth, grey levels", truth.grey}}, truth.grid, std::nullopt, {}});
}

Result<Truth> ReadTruth(const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, Open(path.string()));
  Truth truth;
  truth.grey = Image<float>(dataset->GetRasterXSize(), dataset->GetRasterYSize());
  TREM_RETURN_IF_ERROR(ReadBand(dataset.get(), 1, path.string(), &truth.grey));
  GeoTransform geotransform;
  if (dataset->GetGeoTransform(geotransform.data()) != CE_None) return InvalidInput("truth '" + path.string() + "' is not georeferenced");
  TREM_ASSIGN_OR_RETURN(truth.grid, GridFromGeoTransform(geotransform, truth.grey.width(), truth.grey.height()));
  truth.grid.crs_wkt = dataset->GetProjectionRef();
  return truth;
}

}  // namespace trem
