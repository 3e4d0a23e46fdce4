#include "mosaic/raster/elevation_model.h"

#include <fmt/format.h>
#include <ogr_spatialref.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "mosaic/raster/gdal_env.h"

namespace trem {
namespace {

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

struct DestroyTransformation {
  void operator()(OGRCoordinateTransformation* transformation) const { OGRCoordinateTransformation::DestroyCT(transformation); }
};
using Transformation = std::unique_ptr<OGRCoordinateTransformation, DestroyTransformation>;

std::string Describe(const GeographicBounds& bounds) {
  return fmt::format("longitude {:.5f} to {:.5f}, latitude {:.5f} to {:.5f}", bounds.west_deg, bounds.east_deg, bounds.south_deg,
                     bounds.north_deg);
}

// One raster, and the way from WGS 84 degrees to its pixel centres.
class ElevationFile {
 public:
  static Result<ElevationFile> Open(const std::filesystem::path& path) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(path, error)) return NotFound("elevation model " + path.string() + ": no such file");
    const GdalErrors errors;
    ElevationFile file;
    file.path_ = path.string();
    file.dataset_.reset(GDALDataset::Open(file.path_.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY));
    if (file.dataset_ == nullptr || file.dataset_->GetRasterCount() < 1) {
      return InvalidInput("elevation model " + file.path_ + ": is no raster (" + errors.Text() +
                          "); expected one band of elevations in metres in any format that GDAL reads");
    }
    const OGRSpatialReference* reference = file.dataset_->GetSpatialRef();
    std::array<double, 6> geotransform{};
    if (reference == nullptr || file.dataset_->GetGeoTransform(geotransform.data()) != CE_None ||
        !GDALInvGeoTransform(geotransform.data(), file.pixel_from_map_.data())) {
      return InvalidInput("elevation model " + file.path_ + ": has no " + (reference == nullptr ? "coordinate system" : "geotransform") +
                          "; expected a georeferenced raster (gdal_edit.py -a_srs and -a_ullr can say where it lies)");
    }
    OGRSpatialReference geographic;
    OGRSpatialReference own(*reference);
    geographic.importFromEPSG(4326);
    geographic.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    own.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    file.map_from_geographic_.reset(OGRCreateCoordinateTransformation(&geographic, &own));
    file.geographic_from_map_.reset(OGRCreateCoordinateTransformation(&own, &geographic));
    if (file.map_from_geographic_ == nullptr || file.geographic_from_map_ == nullptr) {
      return InvalidInput("elevation model " + file.path_ + ": its coordinate system has no known relation to WGS 84 (" + errors.Text() +
                          ")");
    }
    file.map_from_pixel_ = geotransform;
    return file;
  }

  const std::string& path() const { return path_; }

  // Column and row with pixel centres at whole numbers; NaN where the projection does not reach.
  Eigen::Vector2d PixelOf(double longitude_deg, double latitude_deg) const {
    double x = longitude_deg;
    double y = latitude_deg;
    int success = 0;
    map_from_geographic_->Transform(1, &x, &y, nullptr, &success);
    if (success == 0) return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    const auto& g = pixel_from_map_;
    return {g[0] + x * g[1] + y * g[2] - 0.5, g[3] + x * g[4] + y * g[5] - 0.5};
  }

  // What the raster covers.
  std::string Coverage() const {
    GeographicBounds bounds{180.0, 90.0, -180.0, -90.0};
    const double w = dataset_->GetRasterXSize();
    const double h = dataset_->GetRasterYSize();
    for (const auto& [p, l] : {std::pair(0.0, 0.0), std::pair(w, 0.0), std::pair(w, h), std::pair(0.0, h)}) {
      double x = map_from_pixel_[0] + p * map_from_pixel_[1] + l * map_from_pixel_[2];
      double y = map_from_pixel_[3] + p * map_from_pixel_[4] + l * map_from_pixel_[5];
      int success = 0;
      geographic_from_map_->Transform(1, &x, &y, nullptr, &success);
      if (success == 0) continue;
      bounds = {std::min(bounds.west_deg, x), std::min(bounds.south_deg, y), std::max(bounds.east_deg, x), std::max(bounds.north_deg, y)};
    }
    return Describe(bounds);
  }

  // Reads the pixels [x0, x1) x [y0, y1) averaged to width x height; NaN where the raster has no value.
  Result<Image<float>> Read(int x0, int y0, int x1, int y1, int width, int height) const {
    const GdalErrors errors;
    Image<float> pixels(width, height);
    GDALRasterBand* band = dataset_->GetRasterBand(1);
    GDALRasterIOExtraArg extra;
    INIT_RASTERIO_EXTRA_ARG(extra);
    extra.eResampleAlg = GRIORA_Average;
    if (band->RasterIO(GF_Read, x0, y0, x1 - x0, y1 - y0, pixels.row(0), width, height, GDT_Float32, 0, 0, &extra) != CE_None) {
      return Corrupt("elevation model " + path_ + ": its pixels cannot be read (" + errors.Text() + ")");
    }
    int has_nodata = 0;
    const double nodata = band->GetNoDataValue(&has_nodata);
    int success = 0;
    const double scale = band->GetScale(&success);
    const double offset = band->GetOffset(&success);
    for (float& z : pixels.pixels()) {
      const bool missing = !std::isfinite(z) || (has_nodata != 0 && z == static_cast<float>(nodata));
      z = missing ? kUnknown : static_cast<float>(z * scale + offset);
      // No ground lies there: a void that the file does not declare.
      if (!(z > -12000.0F && z < 10000.0F)) z = kUnknown;
    }
    return pixels;
  }

  int width() const { return dataset_->GetRasterXSize(); }
  int height() const { return dataset_->GetRasterYSize(); }

 private:
  std::string path_;
  GdalDatasetPtr dataset_;
  Transformation map_from_geographic_;
  Transformation geographic_from_map_;
  std::array<double, 6> map_from_pixel_{};
  std::array<double, 6> pixel_from_map_{};
};

// Rectangle of raster pixels that `bounds` reach, with a margin of one; empty (x1 <= x0) when it lies outside.
struct PixelWindow {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

PixelWindow WindowOf(const ElevationFile& file, const GeographicBounds& bounds) {
  constexpr int kEdgePoints = 16;
  double low_x = 1e18, low_y = 1e18, high_x = -1e18, high_y = -1e18;
  for (int i = 0; i <= kEdgePoints; ++i) {
    for (int k = 0; k <= kEdgePoints; ++k) {
      const Eigen::Vector2d pixel = file.PixelOf(bounds.west_deg + (bounds.east_deg - bounds.west_deg) * i / kEdgePoints,
                                                 bounds.south_deg + (bounds.north_deg - bounds.south_deg) * k / kEdgePoints);
      if (!pixel.allFinite()) continue;
      low_x = std::min(low_x, pixel.x());
      low_y = std::min(low_y, pixel.y());
      high_x = std::max(high_x, pixel.x());
      high_y = std::max(high_y, pixel.y());
    }
  }
  const auto limit = [](double value, int size) { return static_cast<int>(std::clamp(value, 0.0, static_cast<double>(size))); };
  return {limit(std::floor(low_x) - 1.0, file.width()), limit(std::floor(low_y) - 1.0, file.height()),
          limit(std::ceil(high_x) + 2.0, file.width()), limit(std::ceil(high_y) + 2.0, file.height())};
}

}  // namespace

Result<GriddedGround> ReadElevationModel(const std::filesystem::path& path, const GeographicBounds& bounds, int nodes_max) {
  TREM_CHECK(bounds.west_deg < bounds.east_deg && bounds.south_deg < bounds.north_deg && nodes_max >= 2);
  TREM_ASSIGN_OR_RETURN(const ElevationFile file, ElevationFile::Open(path));
  const auto not_covered = [&] {
    return InvalidInput("elevation model " + file.path() + ": covers " + file.Coverage() + " and has no elevation within " +
                        Describe(bounds) + ", where the sortie looks; expected a raster of that area");
  };
  const PixelWindow window = WindowOf(file, bounds);
  if (window.x1 - window.x0 < 2 || window.y1 - window.y0 < 2) return not_covered();
  const int reduced_max = 4 * nodes_max;
  const int width = std::min(window.x1 - window.x0, reduced_max);
  const int height = std::min(window.y1 - window.y0, reduced_max);
  TREM_ASSIGN_OR_RETURN(Image<float> pixels, file.Read(window.x0, window.y0, window.x1, window.y1, width, height));
  if (std::none_of(pixels.pixels().begin(), pixels.pixels().end(), [](float z) { return std::isfinite(z); })) return not_covered();
  // Pixels of the reduced window from those of the raster: centres to centres.
  const double fx = static_cast<double>(width) / (window.x1 - window.x0);
  const double fy = static_cast<double>(height) / (window.y1 - window.y0);
  const GriddedGround raster(Eigen::Vector2d::Zero(), Eigen::Vector2d::Ones(), std::move(pixels));
  const auto elevation = [&](double longitude_deg, double latitude_deg) {
    const Eigen::Vector2d pixel = file.PixelOf(longitude_deg, latitude_deg);
    if (!pixel.allFinite()) return kUnknown;
    const Eigen::Vector2d reduced((pixel.x() + 0.5 - window.x0) * fx - 0.5, (pixel.y() + 0.5 - window.y0) * fy - 0.5);
    const std::optional<double> z = raster.ElevationAt(reduced);
    return z.has_value() ? static_cast<float>(*z) : kUnknown;
  };
  const int columns = std::clamp(width, 2, nodes_max);
  const int rows = std::clamp(height, 2, nodes_max);
  const Eigen::Vector2d origin(bounds.west_deg, bounds.north_deg);
  const Eigen::Vector2d step((bounds.east_deg - bounds.west_deg) / (columns - 1), -(bounds.north_deg - bounds.south_deg) / (rows - 1));
  Image<float> nodes(columns, rows);
  bool any = false;
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      nodes.at(c, r) = elevation(origin.x() + c * step.x(), origin.y() + r * step.y());
      any = any || std::isfinite(nodes.at(c, r));
    }
  }
  if (!any) return not_covered();
  return GriddedGround(origin, step, std::move(nodes));
}

Result<GriddedGround> GroundInWorld(const GriddedGround& geographic, const UtmFrame& map, const Eigen::Vector2d& origin, double scale) {
  const double columns = geographic.elevations_m().width() - 1;
  const double rows = geographic.elevations_m().height() - 1;
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e300);
  Eigen::Vector2d high = Eigen::Vector2d::Constant(-1e300);
  for (int i = 0; i <= 8; ++i) {
    for (int k = 0; k <= 8; ++k) {
      const Eigen::Vector2d at = geographic.origin() + Eigen::Vector2d(columns * i / 8, rows * k / 8).cwiseProduct(geographic.step());
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d x_in_map, map.Forward(at.y(), at.x()));
      const Eigen::Vector2d x_in_world = (x_in_map - origin) / scale;
      low = low.cwiseMin(x_in_world);
      high = high.cwiseMax(x_in_world);
    }
  }
  const int width = geographic.elevations_m().width();
  const int height = geographic.elevations_m().height();
  const Eigen::Vector2d step((high.x() - low.x()) / (width - 1), (high.y() - low.y()) / (height - 1));
  Image<float> nodes(width, height, kUnknown);
  bool any = false;
  for (int r = 0; r < height; ++r) {
    for (int c = 0; c < width; ++c) {
      const Eigen::Vector2d x_in_map = origin + scale * (low + Eigen::Vector2d(c * step.x(), r * step.y()));
      const Result<Eigen::Vector2d> place = map.Inverse(x_in_map);
      if (!place.ok()) continue;
      const std::optional<double> z = geographic.ElevationAt({place->y(), place->x()});
      if (!z.has_value()) continue;
      nodes.at(c, r) = static_cast<float>(*z);
      any = true;
    }
  }
  if (!any) return InvalidInput("the elevation model has no elevation within the target CRS");
  return GriddedGround(low, step, std::move(nodes));
}

}  // namespace trem
