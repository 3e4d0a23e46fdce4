#include "mosaic/raster/geotiff.h"

#include <cpl_string.h>
#include <ogr_spatialref.h>

#include <cmath>
#include <system_error>

#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/georeference.h"

namespace trem {

GeoTransform GeoTransformFromGrid(const MosaicGrid& grid) {
  const double half = 0.5 * grid.gsd;
  return {grid.origin_x - half, grid.gsd, 0.0, grid.origin_y + half, 0.0, -grid.gsd};
}

GeoTransform GeoTransformFromAffine(const Affine& target_from_pixel) {
  const Eigen::Vector2d half = Eigen::Vector2d::Constant(0.5);
  const Eigen::Vector2d corner = target_from_pixel * -half + half;
  const Eigen::Matrix2d& m = target_from_pixel.linear;
  return {corner.x(), m(0, 0), m(0, 1), corner.y(), m(1, 0), m(1, 1)};
}

Result<MosaicGrid> GridFromGeoTransform(const GeoTransform& geotransform, int width, int height) {
  const double gsd = geotransform[1];
  const bool north_up = geotransform[2] == 0.0 && geotransform[4] == 0.0 && gsd > 0.0 && geotransform[5] < 0.0;
  if (!north_up || std::abs(gsd + geotransform[5]) > 1e-9 * gsd) {
    return InvalidInput("the raster's geotransform is rotated or its pixels are not square; expected north-up square pixels");
  }
  MosaicGrid grid;
  grid.gsd = gsd;
  grid.origin_x = geotransform[0] + 0.5 * gsd;
  grid.origin_y = geotransform[3] - 0.5 * gsd;
  grid.width = width;
  grid.height = height;
  return grid;
}

MosaicGrid SubGrid(const MosaicGrid& grid, const Roi& roi) {
  MosaicGrid sub = grid;
  sub.origin_x = grid.origin_x + roi.x0 * grid.gsd;
  sub.origin_y = grid.origin_y - roi.y0 * grid.gsd;
  sub.width = roi.width();
  sub.height = roi.height();
  return sub;
}

Status SetGeoreference(const MosaicGrid& grid, GDALDataset* dataset) {
  GeoTransform geotransform = GeoTransformFromGrid(grid);
  if (dataset->SetGeoTransform(geotransform.data()) != CE_None) return Failed("GDAL does not take the geotransform");
  if (grid.crs_wkt.empty()) return {};
  OGRSpatialReference srs;
  if (srs.importFromWkt(grid.crs_wkt.c_str()) != OGRERR_NONE) {
    return Corrupt("the mosaic's CRS is not valid WKT: '" + grid.crs_wkt.substr(0, 120) + "'");
  }
  srs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  if (dataset->SetSpatialRef(&srs) != CE_None) return Failed("GDAL does not take the mosaic's CRS");
  return {};
}

std::string CrsName(const std::string& crs_wkt) {
  const GdalErrors quiet;
  OGRSpatialReference srs;
  if (crs_wkt.empty() || srs.importFromWkt(crs_wkt.c_str()) != OGRERR_NONE || srs.GetName() == nullptr) return "unnamed";
  return srs.GetName();
}

namespace {

Status FillDataset(const FloatRaster& raster, GDALDataset* dataset) {
  if (raster.grid) TREM_RETURN_IF_ERROR(SetGeoreference(*raster.grid, dataset));
  if (raster.geotransform) {
    GeoTransform geotransform = *raster.geotransform;
    if (dataset->SetGeoTransform(geotransform.data()) != CE_None) return Failed("GDAL does not take the geotransform");
  }
  for (const auto& [key, value] : raster.metadata) dataset->SetMetadataItem(key.c_str(), value.c_str());
  for (std::size_t i = 0; i < raster.bands.size(); ++i) {
    GDALRasterBand* band = dataset->GetRasterBand(static_cast<int>(i) + 1);
    const Image<float>& pixels = raster.bands[i].pixels;
    band->SetDescription(raster.bands[i].description.c_str());
    if (raster.nodata) band->SetNoDataValue(*raster.nodata);
    // GDAL's writing interface takes a pointer to mutable pixels and does not change them.
    auto* data = const_cast<float*>(pixels.pixels().data());
    if (band->RasterIO(GF_Write, 0, 0, pixels.width(), pixels.height(), data, pixels.width(), pixels.height(), GDT_Float32, 0, 0,
                       nullptr) != CE_None) {
      return Failed("band " + std::to_string(i + 1) + " was not written");
    }
  }
  return {};
}

}  // namespace

Status WriteFloatRaster(const std::filesystem::path& path, const FloatRaster& raster) {
  TREM_CHECK(!raster.bands.empty() && !raster.bands[0].pixels.empty());
  TREM_CHECK(!(raster.grid && raster.geotransform));
  const int width = raster.bands[0].pixels.width();
  const int height = raster.bands[0].pixels.height();
  for (const FloatBand& band : raster.bands) TREM_CHECK(band.pixels.width() == width && band.pixels.height() == height);

  GdalErrors errors;
  CPLStringList options;
  for (const char* option : {"TILED=YES", "BLOCKXSIZE=256", "BLOCKYSIZE=256", "COMPRESS=DEFLATE", "ZLEVEL=6", "PREDICTOR=3",
                             "INTERLEAVE=BAND", "BIGTIFF=IF_SAFER", "NUM_THREADS=1"}) {
    options.AddString(option);
  }
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  TREM_CHECK(driver != nullptr);
  GdalDatasetPtr dataset(driver->Create(path.c_str(), width, height, static_cast<int>(raster.bands.size()), GDT_Float32, options.List()));
  if (!dataset) return errors.WriteStatus("cannot create", path);
  const Status filled = FillDataset(raster, dataset.get());
  dataset.reset();  // Writes what is still cached; errors show up in `errors`.
  if (filled.ok() && !errors.failed()) return {};
  const Status failure =
      filled.code() == StatusCode::kCorrupt ? filled.WithPrefix(path.string()) : errors.WriteStatus("cannot write", path);
  std::error_code ignored;
  std::filesystem::remove(path, ignored);
  return failure;
}

Result<FloatRasterInfo> InspectFloatRaster(const std::filesystem::path& path) {
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, OpenTiff(path, "raster"));
  FloatRasterInfo info;
  info.width = dataset->GetRasterXSize();
  info.height = dataset->GetRasterYSize();
  info.band_count = dataset->GetRasterCount();
  char** items = dataset->GetMetadata();
  for (int i = 0; items != nullptr && items[i] != nullptr; ++i) {
    const std::string item = items[i];
    const std::size_t equals = item.find('=');
    if (equals != std::string::npos) info.metadata[item.substr(0, equals)] = item.substr(equals + 1);
  }
  return info;
}

Result<std::vector<Image<float>>> ReadFloatBands(const std::filesystem::path& path, const std::vector<int>& bands,
                                                 const std::optional<Roi>& roi, long long max_pixels) {
  GdalErrors errors;
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, OpenTiff(path, "raster"));
  const Roi all{0, 0, dataset->GetRasterXSize(), dataset->GetRasterYSize()};
  const Roi wanted = roi.value_or(all);
  if (wanted.empty() || !all.Contains(wanted)) {
    return Corrupt("raster " + path.string() + " covers " + ToString(all) + "; expected it to contain " + ToString(wanted));
  }
  if (wanted.area() > max_pixels) {
    return Exhausted("raster " + path.string() + ": " + ToString(wanted) + " has " + std::to_string(wanted.area()) + " pixels; at most " +
                     std::to_string(max_pixels) + " are read at once");
  }
  std::vector<Image<float>> images;
  images.reserve(bands.size());
  for (const int index : bands) {
    if (index < 0 || index >= dataset->GetRasterCount()) {
      return Corrupt("raster " + path.string() + " has " + std::to_string(dataset->GetRasterCount()) + " bands; expected band " +
                     std::to_string(index + 1));
    }
    GDALRasterBand* band = dataset->GetRasterBand(index + 1);
    if (band->GetRasterDataType() != GDT_Float32) {
      return Corrupt("raster " + path.string() + " band " + std::to_string(index + 1) + " is " +
                     GDALGetDataTypeName(band->GetRasterDataType()) + "; expected Float32");
    }
    Image<float> image(wanted.width(), wanted.height());
    if (band->RasterIO(GF_Read, wanted.x0, wanted.y0, wanted.width(), wanted.height(), image.pixels().data(), wanted.width(),
                       wanted.height(), GDT_Float32, 0, 0, nullptr) != CE_None) {
      return errors.ReadStatus("raster", path);
    }
    images.push_back(std::move(image));
  }
  return images;
}

}  // namespace trem
