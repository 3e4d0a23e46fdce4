#include "mosaic/raster/crs.h"

#include <cpl_conv.h>
#include <cpl_error.h>
#include <ogr_spatialref.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <utility>

namespace trem {
namespace {

constexpr double kRadiansPerDegree = std::numbers::pi / 180.0;
// Half step of the numerical differences: about 11 m on the ground, where the projections' curvature is far below 1e-9.
constexpr double kStepDeg = 1e-4;

// Silences GDAL's stderr while one of its calls may fail; the failure is reported by our own message.
class QuietGdal {
 public:
  QuietGdal() {
    CPLPushErrorHandler(CPLQuietErrorHandler);
    CPLErrorReset();
  }
  ~QuietGdal() { CPLPopErrorHandler(); }
  QuietGdal(const QuietGdal&) = delete;
  QuietGdal& operator=(const QuietGdal&) = delete;
};

struct DestroyTransformation {
  void operator()(OGRCoordinateTransformation* transformation) const { OGRCoordinateTransformation::DestroyCT(transformation); }
};
using Transformation = std::unique_ptr<OGRCoordinateTransformation, DestroyTransformation>;

Result<OGRSpatialReference> ParseCrs(const std::string& crs) {
  const QuietGdal quiet;
  OGRSpatialReference reference;
  const char* const options[] = {"ALLOW_NETWORK_ACCESS=NO", "ALLOW_FILE_ACCESS=NO", nullptr};
  if (crs.empty() || reference.SetFromUserInput(crs.c_str(), options) != OGRERR_NONE) {
    const std::string reason = CPLGetLastErrorMsg();
    return InvalidInput("CRS \"" + crs + "\" is unknown" + (reason.empty() ? "" : " (" + reason + ")") +
                        "; expected a projected CRS as GDAL understands it, for example \"EPSG:32630\"");
  }
  reference.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return reference;
}

std::string ExportWkt(const OGRSpatialReference& reference) {
  char* text = nullptr;
  reference.exportToWkt(&text);
  std::string wkt = text == nullptr ? "" : text;
  CPLFree(text);
  return wkt;
}

std::string PointText(double latitude_deg, double longitude_deg) {
  return "latitude " + std::to_string(latitude_deg) + ", longitude " + std::to_string(longitude_deg);
}

bool OnEarth(double latitude_deg, double longitude_deg) {
  return std::isfinite(latitude_deg) && std::isfinite(longitude_deg) && std::abs(latitude_deg) <= 90.0 && std::abs(longitude_deg) <= 360.0;
}

}  // namespace

int UtmEpsg(double latitude_deg, double longitude_deg) {
  const double wrapped = longitude_deg - 360.0 * std::floor((longitude_deg + 180.0) / 360.0);  // [-180, 180)
  const int zone = std::clamp(static_cast<int>(std::floor((wrapped + 180.0) / 6.0)) + 1, 1, 60);
  return (latitude_deg < 0.0 ? 32700 : 32600) + zone;
}

Result<std::string> CrsWkt(const std::string& crs) {
  TREM_ASSIGN_OR_RETURN(const OGRSpatialReference reference, ParseCrs(crs));
  return ExportWkt(reference);
}

std::optional<int> EpsgOf(const std::string& crs_wkt) {
  const QuietGdal quiet;
  OGRSpatialReference reference;
  if (reference.importFromWkt(crs_wkt.c_str()) != OGRERR_NONE) return std::nullopt;
  const char* const authority = reference.GetAuthorityName(nullptr);
  const char* const code = reference.GetAuthorityCode(nullptr);
  if (authority == nullptr || code == nullptr || std::string(authority) != "EPSG") return std::nullopt;
  return std::atoi(code);
}

std::string Wkt2(const std::string& crs_wkt) {
  const QuietGdal quiet;
  OGRSpatialReference reference;
  if (reference.importFromWkt(crs_wkt.c_str()) != OGRERR_NONE) return "";
  const char* const options[] = {"FORMAT=WKT2_2019", "MULTILINE=NO", nullptr};
  char* text = nullptr;
  const bool done = reference.exportToWkt(&text, options) == OGRERR_NONE && text != nullptr;
  std::string wkt = done ? text : "";
  CPLFree(text);
  return wkt;
}

std::string LocalPixelCrsWkt() { return R"(LOCAL_CS["local, sensor pixels",UNIT["pixel",1],AXIS["X",EAST],AXIS["Y",NORTH]])"; }

struct UtmFrame::State {
  std::string name;
  std::string wkt;
  Transformation map_from_geographic;
  Transformation geographic_from_map;
};

UtmFrame::UtmFrame(std::unique_ptr<State> state) : state_(std::move(state)) {}
UtmFrame::UtmFrame(UtmFrame&&) noexcept = default;
UtmFrame& UtmFrame::operator=(UtmFrame&&) noexcept = default;
UtmFrame::~UtmFrame() = default;

Result<UtmFrame> UtmFrame::ForPoint(double latitude_deg, double longitude_deg) {
  if (!OnEarth(latitude_deg, longitude_deg)) {
    return InvalidInput(PointText(latitude_deg, longitude_deg) + " is not on Earth; expected latitude in -90..90, longitude in -180..180");
  }
  return ForCrs("EPSG:" + std::to_string(UtmEpsg(latitude_deg, longitude_deg)));
}

Result<UtmFrame> UtmFrame::ForCrs(const std::string& crs) {
  TREM_ASSIGN_OR_RETURN(OGRSpatialReference map, ParseCrs(crs));
  if (!map.IsProjected()) {
    return InvalidInput("CRS \"" + crs + "\" is " + (map.IsGeographic() ? "geographic (degrees)" : "not projected") +
                        "; a mosaic's ground sample distance is in metres: give a projected CRS such as \"EPSG:32630\", or none for UTM");
  }
  const double unit_m = map.GetLinearUnits();
  if (std::abs(unit_m - 1.0) > 1e-9) {
    return InvalidInput("CRS \"" + crs + "\" has a unit of " + std::to_string(unit_m) + " m; expected a projected CRS in metres");
  }
  TREM_ASSIGN_OR_RETURN(OGRSpatialReference geographic, ParseCrs("EPSG:4326"));
  const QuietGdal quiet;
  auto state = std::make_unique<State>();
  state->name = crs;
  state->wkt = ExportWkt(map);
  state->map_from_geographic.reset(OGRCreateCoordinateTransformation(&geographic, &map));
  state->geographic_from_map.reset(OGRCreateCoordinateTransformation(&map, &geographic));
  if (state->map_from_geographic == nullptr || state->geographic_from_map == nullptr) {
    return InvalidInput("no transformation between WGS 84 and CRS \"" + crs + "\" is known (" + CPLGetLastErrorMsg() + ")");
  }
  return UtmFrame(std::move(state));
}

const std::string& UtmFrame::wkt() const { return state_->wkt; }

Result<Eigen::Vector2d> UtmFrame::Forward(double latitude_deg, double longitude_deg) const {
  const QuietGdal quiet;
  double x = longitude_deg;
  double y = latitude_deg;
  int success = 0;
  if (OnEarth(latitude_deg, longitude_deg)) state_->map_from_geographic->Transform(1, &x, &y, nullptr, &success);
  if (success == 0 || !std::isfinite(x) || !std::isfinite(y)) {
    return InvalidInput(PointText(latitude_deg, longitude_deg) + " can't be projected to CRS \"" + state_->name + "\"");
  }
  return Eigen::Vector2d(x, y);
}

Result<Eigen::Vector2d> UtmFrame::Inverse(const Eigen::Vector2d& x_in_map) const {
  const QuietGdal quiet;
  double x = x_in_map.x();
  double y = x_in_map.y();
  int success = 0;
  state_->geographic_from_map->Transform(1, &x, &y, nullptr, &success);
  if (success == 0 || !std::isfinite(x) || !std::isfinite(y)) {
    return InvalidInput("the point (" + std::to_string(x_in_map.x()) + ", " + std::to_string(x_in_map.y()) + ") is outside CRS \"" +
                        state_->name + "\"");
  }
  return Eigen::Vector2d(y, x);
}

Result<double> UtmFrame::ConvergenceRad(double latitude_deg, double longitude_deg) const {
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d south, Forward(latitude_deg - kStepDeg, longitude_deg));
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d north, Forward(latitude_deg + kStepDeg, longitude_deg));
  return -std::atan2(north.x() - south.x(), north.y() - south.y());
}

Result<double> UtmFrame::ScaleFactor(double latitude_deg, double longitude_deg) const {
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d south, Forward(latitude_deg - kStepDeg, longitude_deg));
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d north, Forward(latitude_deg + kStepDeg, longitude_deg));
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d west, Forward(latitude_deg, longitude_deg - kStepDeg));
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d east, Forward(latitude_deg, longitude_deg + kStepDeg));
  // Radii of curvature of the WGS 84 ellipsoid (Snyder, Map Projections, USGS 1395, eq. 4-18 and 4-20).
  constexpr double kSemiMajorM = 6378137.0;
  constexpr double kEccentricity2 = 6.69437999014e-3;
  const double sin_latitude = std::sin(latitude_deg * kRadiansPerDegree);
  const double w2 = 1.0 - kEccentricity2 * sin_latitude * sin_latitude;
  const double meridian_m = kSemiMajorM * (1.0 - kEccentricity2) / (w2 * std::sqrt(w2));
  const double parallel_m = kSemiMajorM / std::sqrt(w2) * std::cos(latitude_deg * kRadiansPerDegree);
  const double step_rad = 2.0 * kStepDeg * kRadiansPerDegree;
  const Eigen::Vector2d along_north = (north - south) / (meridian_m * step_rad);
  const Eigen::Vector2d along_east = (east - west) / (parallel_m * step_rad);
  return std::sqrt(std::abs(along_east.x() * along_north.y() - along_east.y() * along_north.x()));
}

}  // namespace trem
