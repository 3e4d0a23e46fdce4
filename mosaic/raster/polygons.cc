#include "mosaic/raster/polygons.h"

#include <ogr_spatialref.h>
#include <ogrsf_frmts.h>

#include <cmath>
#include <system_error>

#include "mosaic/raster/gdal_env.h"

namespace trem {
namespace {

// Pieces that an edge is split into before it is reprojected.
constexpr int kPiecesPerEdge = 16;

Status AddRing(const OGRLinearRing& ring, const std::filesystem::path& path, std::size_t* vertex_count, PolygonRings* polygons) {
  std::vector<Eigen::Vector2d> points;
  int count = ring.getNumPoints();
  if (count > 1 && ring.getX(0) == ring.getX(count - 1) && ring.getY(0) == ring.getY(count - 1)) --count;
  *vertex_count += static_cast<std::size_t>(std::max(count, 0));
  if (*vertex_count > kPolygonVerticesMax) {
    return InvalidInput("polygons " + path.string() + " have more than " + std::to_string(kPolygonVerticesMax) +
                        " vertices; simplify them first");
  }
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d point(ring.getX(i), ring.getY(i));
    if (!point.allFinite()) return InvalidInput("polygons " + path.string() + " have a coordinate that is not a finite number");
    points.push_back(point);
  }
  if (points.size() >= 3) polygons->rings.push_back(std::move(points));
  return {};
}

Status AddGeometry(const OGRGeometry& geometry, const std::filesystem::path& path, std::size_t* vertex_count, PolygonRings* polygons) {
  switch (wkbFlatten(geometry.getGeometryType())) {
    case wkbPolygon:
      for (const OGRLinearRing* ring : *geometry.toPolygon()) {
        TREM_RETURN_IF_ERROR(AddRing(*ring, path, vertex_count, polygons));
      }
      return {};
    case wkbMultiPolygon:
      for (const OGRPolygon* polygon : *geometry.toMultiPolygon()) {
        TREM_RETURN_IF_ERROR(AddGeometry(*polygon, path, vertex_count, polygons));
      }
      return {};
    default:
      return InvalidInput("polygons " + path.string() + " hold a " + geometry.getGeometryName() + "; expected Polygon or MultiPolygon");
  }
}

Status AddLayer(OGRLayer* layer, const std::filesystem::path& path, std::size_t* vertex_count, PolygonRings* polygons) {
  const OGRSpatialReference* srs = layer->GetSpatialRef();
  char* text = nullptr;
  if (srs == nullptr || srs->exportToWkt(&text) != OGRERR_NONE) {
    CPLFree(text);
    return InvalidInput("polygons " + path.string() + " have no coordinate reference system; write one into the file");
  }
  const std::string wkt = text;
  CPLFree(text);
  if (!polygons->crs_wkt.empty() && polygons->crs_wkt != wkt) {
    return InvalidInput("polygons " + path.string() + " have layers in different coordinate reference systems; expected one");
  }
  polygons->crs_wkt = wkt;
  layer->ResetReading();
  while (OGRFeatureUniquePtr feature = OGRFeatureUniquePtr(layer->GetNextFeature())) {
    if (feature->GetGeometryRef() == nullptr) continue;
    TREM_RETURN_IF_ERROR(AddGeometry(*feature->GetGeometryRef(), path, vertex_count, polygons));
  }
  return {};
}

}  // namespace

Result<PolygonRings> ReadPolygons(const std::filesystem::path& path) {
  GdalErrors errors;
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(path, error);
  if (error) return NotFound("polygons " + path.string() + ": " + error.message());
  if (bytes > kPolygonFileBytesMax) {
    return InvalidInput("polygons " + path.string() + " take " + std::to_string(bytes) + " bytes; expected at most " +
                        std::to_string(kPolygonFileBytesMax));
  }
  const char* const drivers[] = {"GeoJSON", "GPKG", nullptr};
  const GdalDatasetPtr dataset(
      static_cast<GDALDataset*>(GDALOpenEx(path.c_str(), GDAL_OF_VECTOR | GDAL_OF_READONLY, drivers, nullptr, nullptr)));
  if (!dataset) return InvalidInput("polygons " + path.string() + " cannot be read as GeoJSON or GeoPackage: " + errors.Text());
  PolygonRings polygons;
  std::size_t vertex_count = 0;
  for (int i = 0; i < dataset->GetLayerCount(); ++i) {
    TREM_RETURN_IF_ERROR(AddLayer(dataset->GetLayer(i), path, &vertex_count, &polygons));
  }
  if (errors.failed()) return InvalidInput("polygons " + path.string() + ": " + errors.Text());
  if (polygons.rings.empty()) return InvalidInput("polygons " + path.string() + " hold no polygon");
  return polygons;
}

Result<PolygonRings> Reproject(const PolygonRings& polygons, const std::string& crs_wkt) {
  const GdalErrors errors;
  OGRSpatialReference from, to;
  if (from.importFromWkt(polygons.crs_wkt.c_str()) != OGRERR_NONE || to.importFromWkt(crs_wkt.c_str()) != OGRERR_NONE) {
    return InvalidInput("the polygons' or the mosaic's coordinate reference system is not valid WKT");
  }
  from.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  to.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  OGRCoordinateTransformation* const transformation = OGRCreateCoordinateTransformation(&from, &to);
  if (transformation == nullptr) return InvalidInput("the polygons cannot be projected to the mosaic's CRS: " + errors.Text());
  PolygonRings projected;
  projected.crs_wkt = crs_wkt;
  bool all_fit = true;
  for (const std::vector<Eigen::Vector2d>& ring : polygons.rings) {
    std::vector<Eigen::Vector2d>& points = projected.rings.emplace_back();
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Eigen::Vector2d& a = ring[i];
      const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
      for (int k = 0; k < kPiecesPerEdge; ++k) {
        const Eigen::Vector2d at = a + static_cast<double>(k) / kPiecesPerEdge * (b - a);
        double x = at.x(), y = at.y();
        int success = 0;
        transformation->Transform(1, &x, &y, nullptr, &success);
        all_fit = all_fit && success != 0 && std::isfinite(x) && std::isfinite(y);
        points.push_back({x, y});
      }
    }
  }
  OGRCoordinateTransformation::DestroyCT(transformation);
  if (!all_fit) return InvalidInput("a vertex of the polygons lies outside of what the mosaic's CRS can show");
  return projected;
}

}  // namespace trem
