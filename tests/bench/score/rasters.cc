#include "tests/bench/score/rasters.h"

#include <fmt/format.h>
#include <ogr_spatialref.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"

namespace trem::score {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

Status CheckCrs(const std::filesystem::path& path, const char* wkt, const std::string& truth_crs_wkt) {
  OGRSpatialReference mosaic_crs;
  OGRSpatialReference truth_crs;
  if (wkt == nullptr || mosaic_crs.importFromWkt(wkt) != OGRERR_NONE) {
    return InvalidInput("mosaic '" + path.string() + "' has no coordinate reference system; only a georeferenced mosaic can be scored");
  }
  if (truth_crs.importFromWkt(truth_crs_wkt.c_str()) != OGRERR_NONE)
    return InvalidInput("the truth has no valid coordinate reference system");
  const char* const options[] = {"IGNORE_DATA_AXIS_TO_SRS_AXIS_MAPPING=YES", nullptr};
  if (mosaic_crs.IsSame(&truth_crs, options) == 0) {
    return InvalidInput(fmt::format("mosaic '{}' is in {}, the truth in {}; make the mosaic in the truth's", path.string(),
                                    mosaic_crs.GetName(), truth_crs.GetName()));
  }
  return {};
}

// Keys' cubic convolution weights for samples at -1, 0, 1, 2, taken at t in [0, 1).
void KeysWeights(double t, double* w) {
  w[0] = ((-0.5 * t + 1.0) * t - 0.5) * t;
  w[1] = (1.5 * t - 2.5) * t * t + 1.0;
  w[2] = ((-1.5 * t + 2.0) * t + 0.5) * t;
  w[3] = (0.5 * t - 0.5) * t * t;
}

// Precondition: 1 <= x < width - 2, 1 <= y < height - 2.
double Bicubic(const Image<float>& image, double x, double y) {
  const int x0 = static_cast<int>(x);
  const int y0 = static_cast<int>(y);
  double wx[4];
  double wy[4];
  KeysWeights(x - x0, wx);
  KeysWeights(y - y0, wy);
  double sum = 0.0;
  for (int j = 0; j < 4; ++j) {
    const float* row = image.row(y0 - 1 + j) + x0 - 1;
    sum += wy[j] * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
  }
  return sum;
}

// The steps of a scene's 3:1 grid on the ground, cells of the truth: a third of a sensor pixel's footprint along the image's rows (first
// column) and columns, at the image centre of the middle frame.
Eigen::Matrix2d ScenesCells(const SimulationRecord& record) {
  const Exposure& middle = record.flight.exposures[record.flight.exposures.size() / 2];
  const int width = record.options.width_px, height = record.options.height_px;
  const Eigen::Vector2d centre(0.5 * (width - 1), 0.5 * (height - 1));
  const auto cell = [&](const Eigen::Vector2d& u) {
    return record.truth.CellFromMap(GroundFromPixel(middle.camera, record.flight.focal_px, width, height, u));
  };
  Eigen::Matrix2d steps;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d half = 0.5 * Eigen::Vector2d::Unit(axis);
    steps.col(axis) = (cell(centre + half) - cell(centre - half)) / 3.0;
  }
  return steps;
}

// All frames with gain and offset undone: the truth's grey levels.
Result<std::vector<Image<float>>> ReadFrames(const std::filesystem::path& simulation, const SimulationRecord& record) {
  std::vector<Image<float>> frames;
  const double counts_per_grey = record.options.bit_depth == 16 ? 256.0 : 1.0;
  for (const Exposure& exposure : record.flight.exposures) {
    const std::filesystem::path path = simulation / "frames" / FrameName(exposure.index);
    const cv::Mat read = cv::imread(path.string(), cv::IMREAD_GRAYSCALE | cv::IMREAD_ANYDEPTH);
    if (read.cols != record.options.width_px || read.rows != record.options.height_px) {
      return InvalidInput(fmt::format("frame '{}': found {} x {} pixels, expected {} x {}; simulate again", path.string(), read.cols,
                                      read.rows, record.options.width_px, record.options.height_px));
    }
    Image<float> frame(read.cols, read.rows);
    cv::Mat target(frame.height(), frame.width(), CV_32F, frame.row(0));
    read.convertTo(target, CV_32F, 1.0 / (counts_per_grey * exposure.gain), -exposure.offset / exposure.gain);
    frames.push_back(std::move(frame));
  }
  return frames;
}

}  // namespace

Result<MosaicImage> ReadMosaic(const std::filesystem::path& path, const std::string& truth_crs_wkt) {
  InitialiseGdal();
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr dataset, OpenTiff(path, "mosaic"));
  const GdalErrors errors;
  TREM_RETURN_IF_ERROR(CheckCrs(path, dataset->GetProjectionRef(), truth_crs_wkt));
  GeoTransform geotransform;
  if (dataset->GetGeoTransform(geotransform.data()) != CE_None) return InvalidInput("mosaic '" + path.string() + "' is not georeferenced");
  MosaicImage mosaic;
  mosaic.grey = Image<float>(dataset->GetRasterXSize(), dataset->GetRasterYSize());
  TREM_ASSIGN_OR_RETURN(mosaic.grid, GridFromGeoTransform(geotransform, mosaic.grey.width(), mosaic.grey.height()));
  Image<std::uint8_t> mask(mosaic.grey.width(), mosaic.grey.height());
  GDALRasterBand* band = dataset->GetRasterBand(1);
  if (band->RasterIO(GF_Read, 0, 0, mask.width(), mask.height(), mosaic.grey.row(0), mask.width(), mask.height(), GDT_Float32, 0, 0,
                     nullptr) != CE_None ||
      band->GetMaskBand()->RasterIO(GF_Read, 0, 0, mask.width(), mask.height(), mask.row(0), mask.width(), mask.height(), GDT_Byte, 0, 0,
                                    nullptr) != CE_None) {
    return errors.ReadStatus("mosaic", path);
  }
  for (std::size_t i = 0; i < mask.pixels().size(); ++i) {
    if (mask.pixels()[i] == 0) mosaic.grey.pixels()[i] = kNone;
  }
  return mosaic;
}

Reference::Reference(const SimulationRecord& record) : truth_grid_(record.truth.grid) {
  const SplineSurface truth(record.truth.grey);
  const Eigen::Matrix2d tap = ScenesCells(record);
  Image<float> filtered(truth.width(), truth.height());
  const auto inside = [](double v, int count) { return std::clamp(v, 0.0, count - 1.0); };
  for (int y = 0; y < filtered.height(); ++y) {
    for (int x = 0; x < filtered.width(); ++x) {
      double sum = 0.0;
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) {
          sum +=
              (i == 0 ? 0.5 : 0.25) * (j == 0 ? 0.5 : 0.25) *
              truth.At(inside(x + i * tap(0, 0) + j * tap(0, 1), truth.width()), inside(y + i * tap(1, 0) + j * tap(1, 1), truth.height()));
        }
      }
      filtered.at(x, y) = static_cast<float>(sum);
    }
  }
  surface_ = SplineSurface(filtered);
}

bool Reference::Covers(const Eigen::Vector2d& x_in_map) const {
  const Eigen::Vector2d cell = truth_grid_.PixelFromWorld(x_in_map);
  return cell.x() >= 0.0 && cell.y() >= 0.0 && cell.x() <= surface_.width() - 1.0 && cell.y() <= surface_.height() - 1.0;
}

double Reference::At(const Eigen::Vector2d& x_in_map) const {
  const Eigen::Vector2d cell = truth_grid_.PixelFromWorld(x_in_map);
  return surface_.At(std::clamp(cell.x(), 0.0, surface_.width() - 1.0), std::clamp(cell.y(), 0.0, surface_.height() - 1.0));
}

Image<float> Reference::OnGrid(const MosaicGrid& grid, const Eigen::Vector2d& shift_m) const {
  Image<float> image(grid.width, grid.height);
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const Eigen::Vector2d place = grid.WorldFromPixel({x * 1.0, y * 1.0}) - shift_m;
      image.at(x, y) = static_cast<float>(At(place));
    }
  }
  return image;
}

Result<Image<float>> BicubicFrames(const std::filesystem::path& simulation, const SimulationRecord& record, const MosaicGrid& grid,
                                   const Eigen::Vector2d& shift_m) {
  TREM_ASSIGN_OR_RETURN(const std::vector<Image<float>> frames, ReadFrames(simulation, record));
  const int width = record.options.width_px;
  const int height = record.options.height_px;
  const double focal_px = record.flight.focal_px;
  const std::vector<Exposure>& exposures = record.flight.exposures;
  std::vector<Eigen::Vector2d> centres;
  for (const Exposure& e : exposures)
    centres.push_back(GroundFromPixel(e.camera, focal_px, width, height, {0.5 * (width - 1), 0.5 * (height - 1)}));

  constexpr int kBlock = 16;
  Image<float> image(grid.width, grid.height, kNone);
  std::vector<std::size_t> order(exposures.size());
  std::vector<double> distance(exposures.size());
  for (int by = 0; by < grid.height; by += kBlock) {
    for (int bx = 0; bx < grid.width; bx += kBlock) {
      const Eigen::Vector2d middle = grid.WorldFromPixel({bx + 0.5 * kBlock, by + 0.5 * kBlock}) - shift_m;
      for (std::size_t i = 0; i < centres.size(); ++i) distance[i] = (centres[i] - middle).squaredNorm();
      std::iota(order.begin(), order.end(), std::size_t{0});
      std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return distance[a] < distance[b]; });
      for (int y = by; y < std::min(by + kBlock, grid.height); ++y) {
        for (int x = bx; x < std::min(bx + kBlock, grid.width); ++x) {
          const Eigen::Vector2d place = grid.WorldFromPixel({x * 1.0, y * 1.0}) - shift_m;
          for (const std::size_t i : order) {
            const Eigen::Vector2d u = PixelFromGround(exposures[i].camera, focal_px, width, height, place);
            if (u.x() < 1.0 || u.y() < 1.0 || u.x() >= width - 2.0 || u.y() >= height - 2.0) continue;
            image.at(x, y) = static_cast<float>(Bicubic(frames[i], u.x(), u.y()));
            break;
          }
        }
      }
    }
  }
  return image;
}

double Coverage(const SimulationRecord& record, const MosaicImage& mosaic, const Eigen::Vector2d& shift_m) {
  constexpr int kBorderPx = 3;
  constexpr int kSubpixelBits = 8;
  MosaicGrid cells = record.truth.grid;  // One cell a sensor pixel, over the truth.
  cells.gsd = record.options.gsd_m;
  cells.width = static_cast<int>(record.truth.grey.width() / record.options.cells_per_pixel);
  cells.height = static_cast<int>(record.truth.grey.height() / record.options.cells_per_pixel);
  cv::Mat seen = cv::Mat::zeros(cells.height, cells.width, CV_8U);
  const double right = record.options.width_px - 1.0;
  const double bottom = record.options.height_px - 1.0;
  for (const Exposure& exposure : record.flight.exposures) {
    std::vector<cv::Point> corners;
    for (const Eigen::Vector2d& u :
         {Eigen::Vector2d(0, 0), Eigen::Vector2d(right, 0), Eigen::Vector2d(right, bottom), Eigen::Vector2d(0, bottom)}) {
      const Eigen::Vector2d ground =
          GroundFromPixel(exposure.camera, record.flight.focal_px, record.options.width_px, record.options.height_px, u);
      const Eigen::Vector2d cell = cells.PixelFromWorld(ground) * (1 << kSubpixelBits);
      corners.emplace_back(static_cast<int>(std::lround(cell.x())), static_cast<int>(std::lround(cell.y())));
    }
    cv::fillConvexPoly(seen, corners, cv::Scalar(255), cv::LINE_8, kSubpixelBits);
  }
  cv::erode(seen, seen, cv::Mat::ones(2 * kBorderPx + 1, 2 * kBorderPx + 1, CV_8U), {-1, -1}, 1, cv::BORDER_CONSTANT, cv::Scalar(0));
  long long wanted = 0;
  long long covered = 0;
  for (int y = 0; y < cells.height; ++y) {
    for (int x = 0; x < cells.width; ++x) {
      if (seen.at<std::uint8_t>(y, x) == 0) continue;
      ++wanted;
      const Eigen::Vector2d pixel = mosaic.grid.PixelFromWorld(cells.WorldFromPixel({x * 1.0, y * 1.0}) + shift_m);
      const int column = static_cast<int>(std::lround(pixel.x()));
      const int row = static_cast<int>(std::lround(pixel.y()));
      if (column < 0 || row < 0 || column >= mosaic.grey.width() || row >= mosaic.grey.height()) continue;
      if (std::isfinite(mosaic.grey.at(column, row))) ++covered;
    }
  }
  return wanted > 0 ? static_cast<double>(covered) / static_cast<double>(wanted) : 0.0;
}

}  // namespace trem::score
