#include "worker/tasks/export_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "mosaic/composite/warp.h"
#include "mosaic/geometry/footprint.h"
#include "mosaic/publish/picture.h"
#include "mosaic/raster/crs.h"
#include "proto/codec/convert.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/vignetting.h"

namespace trem {
namespace {

// More would make the page large and the map a tangle.
constexpr std::size_t kFootprintsDrawn = 300;
constexpr std::size_t kPointsDrawn = 2000;
constexpr int kWarpMarginPx = 4;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::size_t StepFor(std::size_t count, std::size_t most) { return std::max<std::size_t>(1, (count + most - 1) / most); }

Result<std::vector<Eigen::Vector2d>> RingInMosaic(const MosaicGrid& grid, const Homography& world_from_source, const Roi& roi) {
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  TREM_ASSIGN_OR_RETURN(const Homography normalised, NormalisedAt(world_from_source, centre));
  std::vector<Eigen::Vector2d> ring = ProjectRoi(normalised, roi);
  for (Eigen::Vector2d& point : ring) point = grid.PixelFromWorld(point);
  return ring;
}

Status AddCorners(const MosaicGrid& grid, ReportData* report) {
  TREM_ASSIGN_OR_RETURN(const UtmFrame frame, UtmFrame::ForCrs(grid.crs_wkt));
  const std::pair<const char*, Eigen::Vector2d> corners[] = {{"Upper left", {-0.5, -0.5}},
                                                             {"Lower right", {grid.width - 0.5, grid.height - 0.5}}};
  for (const auto& [name, pixel] : corners) {
    const Eigen::Vector2d world = grid.WorldFromPixel(pixel);
    const Result<Eigen::Vector2d> place = frame.Inverse(world);
    std::string text = fmt::format("{:.2f}, {:.2f} m", world.x(), world.y());
    if (place.ok()) text += fmt::format("; latitude {:.6f}, longitude {:.6f}", place->x(), place->y());
    report->map.corners.push_back({name, text});
  }
  return {};
}

// One chart over the aligned frames; a frame that is missing breaks its lines.
class FrameChart {
 public:
  FrameChart(std::string title, std::string y_label, const std::vector<std::string>& names) {
    chart_.title = std::move(title);
    chart_.x_label = "frame";
    chart_.y_label = std::move(y_label);
    for (const std::string& name : names) chart_.lines.push_back({name, {}, {}});
  }
  void Add(std::uint32_t frame, std::uint32_t step, const std::vector<double>& values) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      ChartLine& line = chart_.lines[i];
      if (!line.x.empty() && frame > last_ + step) {
        line.x.push_back(0.5 * (last_ + frame));
        line.y.push_back(kNan);
      }
      line.x.push_back(frame);
      line.y.push_back(values[i]);
    }
    last_ = frame;
  }
  const LineChart& chart() const { return chart_; }

 private:
  LineChart chart_;
  std::uint32_t last_ = 0;
};

// How the coefficients of the map from sensor to ground, in sensor GSDs, depart from their medians over the frames: one after the other
// they would be four straight lines.
LineChart AffineChart(const std::vector<std::pair<std::uint32_t, std::array<double, 4>>>& coefficients, std::uint32_t step) {
  std::array<double, 4> median{};
  std::vector<std::string> names;
  for (std::size_t k = 0; k < median.size() && !coefficients.empty(); ++k) {
    std::vector<double> values;
    for (const auto& [frame, numbers] : coefficients) values.push_back(numbers[k]);
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    median[k] = *middle;
    constexpr const char* kNames[] = {"a11", "a12", "a21", "a22"};
    names.push_back(fmt::format("{} {:+.3f}", kNames[k], median[k]));
  }
  FrameChart chart("Affine coefficients, ground from sensor, per sensor GSD", "departure from the median that the legend gives, 1e-3",
                   names);
  for (const auto& [frame, numbers] : coefficients) {
    std::vector<double> departures;
    for (std::size_t k = 0; k < median.size(); ++k) departures.push_back(1e3 * (numbers[k] - median[k]));
    chart.Add(frame, step, departures);
  }
  return chart.chart();
}

// The frame that has the middle of `roi` nearest to its own middle and all of it inside; none when there is none.
Result<std::optional<FramePlacement>> BestFrame(const v1::SortieManifest& manifest, const std::vector<FramePlacement>& frames,
                                                const MosaicGrid& grid, const Roi& roi) {
  const Roi image{0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  const Eigen::Vector2d middle(0.5 * (image.x1 - 1), 0.5 * (image.y1 - 1));
  std::optional<FramePlacement> best;
  double least = std::numeric_limits<double>::infinity();
  for (const FramePlacement& frame : frames) {
    Homography sensor_from_world;
    const Result<Homography> normalised = NormalisedAt(frame.world_from_sensor, middle);
    if (!normalised.ok()) continue;
    sensor_from_world = normalised->Inverse();
    bool inside = true;
    for (const double x : {roi.x0 - 1.0, static_cast<double>(roi.x1)}) {
      for (const double y : {roi.y0 - 1.0, static_cast<double>(roi.y1)}) {
        const Eigen::Vector2d world = grid.WorldFromPixel({x, y});
        if (!IsVisibleDepth(sensor_from_world.Depth(world))) {
          inside = false;
          continue;
        }
        const Eigen::Vector2d at = sensor_from_world * world;
        inside = inside && at.x() >= 2.0 && at.y() >= 2.0 && at.x() <= image.x1 - 3.0 && at.y() <= image.y1 - 3.0;
      }
    }
    if (!inside) continue;
    const Eigen::Vector2d world = grid.WorldFromPixel({0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)});
    const double distance = (sensor_from_world * world - middle).norm();
    if (distance < least) {
      least = distance;
      best = frame;
    }
  }
  return best;
}

// `pixels`, of which the upper left one is (x0, y0) of its plane, resampled bicubically onto `roi_in_mosaic`.
Image<float> Resampled(Image<float> pixels, const Roi& roi_in_plane, const Homography& plane_from_mosaic, const Roi& roi_in_mosaic) {
  SceneRaster raster;
  raster.roi = {0, 0, roi_in_plane.width(), roi_in_plane.height()};
  raster.information = Image<float>(roi_in_plane.width(), roi_in_plane.height(), 1.0f);
  raster.intensity = std::move(pixels);
  const Result<WarpSource> source = PrepareWarp(std::move(raster), roi_in_plane);
  TREM_CHECK(source.ok());
  return WarpScene(*source, plane_from_mosaic, roi_in_mosaic).intensity;
}

Homography WorldFromPixel(const MosaicGrid& grid) {
  Homography map;
  map.matrix << grid.gsd, 0.0, grid.origin_x, 0.0, -grid.gsd, grid.origin_y, 0.0, 0.0, 1.0;
  return map;
}

std::string PlaceText(const MosaicGrid& grid, const Roi& roi, bool georeferenced) {
  const Eigen::Vector2d world = grid.WorldFromPixel({0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)});
  return fmt::format("{:.4g} {} wide, at {:.1f}, {:.1f}", roi.width() * grid.gsd, georeferenced ? "m" : "px", world.x(), world.y());
}

}  // namespace

Status FillReportMap(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid,
                     const std::vector<SceneFootprint>& footprints, ReportData* report) {
  report->map.footprint_count = static_cast<std::uint32_t>(footprints.size());
  for (std::size_t i = 0; i < footprints.size(); i += StepFor(footprints.size(), kFootprintsDrawn)) {
    const Result<std::vector<Eigen::Vector2d>> ring = RingInMosaic(grid, footprints[i].world_from_scene, footprints[i].raster_in_scene);
    if (ring.ok() && ring->size() >= 3) report->map.footprints.push_back(*ring);
  }
  TREM_ASSIGN_OR_RETURN(const std::vector<FramePlacement> frames, AlignedPlacements(alignment));
  const Eigen::Vector2d centre(0.5 * (manifest.width_px() - 1.0), 0.5 * (manifest.height_px() - 1.0));
  const std::size_t step = StepFor(frames.size(), kPointsDrawn);
  constexpr int kMissingMost = 5;  // A few missing frames do not end a track.
  int last = -1;
  for (std::size_t i = 0; i < frames.size(); i += step) {
    if (last < 0 || frames[i].index > last + static_cast<int>(step) + kMissingMost) report->map.tracks.emplace_back();
    last = frames[i].index;
    const Result<Homography> world_from_sensor = NormalisedAt(frames[i].world_from_sensor, centre);
    if (world_from_sensor.ok()) report->map.tracks.back().push_back(grid.PixelFromWorld(*world_from_sensor * centre));
  }
  return alignment.georeferenced() ? AddCorners(grid, report) : Status();
}

Status FillReportCharts(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid, int ratio,
                        ReportData* report) {
  std::vector<std::pair<std::uint32_t, std::array<double, 4>>> coefficients;
  FrameChart residual("Residual of each frame's ties", "sensor px", {"rms"});
  FrameChart gain("Gain of each frame against the balanced mosaic", "", {"gain"});
  FrameChart offset("Offset of each frame against the balanced mosaic", "grey levels of the source", {"offset"});
  TREM_ASSIGN_OR_RETURN(const std::vector<FramePlacement> frames, AlignedPlacements(alignment));
  std::map<int, double> residual_px;
  for (const v1::AlignedFrame& frame : alignment.frames()) residual_px.emplace(static_cast<int>(frame.frame_index()), frame.residual_px());
  const Eigen::Vector2d centre(0.5 * (manifest.width_px() - 1.0), 0.5 * (manifest.height_px() - 1.0));
  const std::size_t step = StepFor(frames.size(), kPointsDrawn);
  for (std::size_t i = 0; i < frames.size(); i += step) {
    const FramePlacement& frame = frames[i];
    const auto index = static_cast<std::uint32_t>(frame.index), gap = static_cast<std::uint32_t>(step);
    if (frame.world_from_sensor.Depth(centre) != 0.0) {
      // Rows run down and the world's y up: flipped, so that no rotation is the identity.
      const Eigen::Matrix2d a = frame.world_from_sensor.LinearisedAt(centre).linear / (grid.gsd * ratio);
      coefficients.push_back({index, {a(0, 0), a(0, 1), -a(1, 0), -a(1, 1)}});
    }
    residual.Add(index, gap, {residual_px[frame.index]});
    gain.Add(index, gap, {frame.gain});
    offset.Add(index, gap, {frame.offset * manifest.grey_scale()});
  }
  report->charts.push_back(AffineChart(coefficients, static_cast<std::uint32_t>(step)));
  for (const FrameChart* chart : {&residual, &gain, &offset}) report->charts.push_back(chart->chart());
  return {};
}

Roi SensorRoi(const MosaicGrid& grid, const Roi& roi_in_mosaic, const MosaicGrid& sensor_grid) {
  const Eigen::Vector2d low = sensor_grid.PixelFromWorld(grid.WorldFromPixel({roi_in_mosaic.x0 - 0.5, roi_in_mosaic.y0 - 0.5}));
  const Eigen::Vector2d high = sensor_grid.PixelFromWorld(grid.WorldFromPixel({roi_in_mosaic.x1 - 0.5, roi_in_mosaic.y1 - 0.5}));
  const Roi roi{static_cast<int>(std::floor(low.x())) - kWarpMarginPx, static_cast<int>(std::floor(low.y())) - kWarpMarginPx,
                static_cast<int>(std::ceil(high.x())) + kWarpMarginPx, static_cast<int>(std::ceil(high.y())) + kWarpMarginPx};
  return Intersect(roi, {0, 0, sensor_grid.width, sensor_grid.height});
}

Image<float> EnlargedOnto(const MosaicGrid& grid, const Roi& roi_in_mosaic, const MosaicGrid& sensor_grid, const Roi& roi_in_sensor_grid,
                          const Image<float>& pixels) {
  const Homography plane_from_mosaic = WorldFromPixel(sensor_grid).Inverse() * WorldFromPixel(grid);
  return Resampled(pixels, roi_in_sensor_grid, plane_from_mosaic, roi_in_mosaic);
}

Result<std::vector<ReportCrop>> MakeCrops(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid,
                                          const MosaicGrid& sensor_grid, const std::vector<Roi>& rois_in_mosaic, const MosaicReader& mosaic,
                                          const FrameMosaic& baseline, const std::function<bool(double)>& progress) {
  std::vector<ReportCrop> crops;
  if (rois_in_mosaic.empty()) return crops;
  TREM_ASSIGN_OR_RETURN(const std::vector<FramePlacement> frames, AlignedPlacements(alignment));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest));
  const Roi image{0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  const Image<float> brightening = BrighteningOf(manifest.sensor(), image.width(), image.height());
  for (const Roi& roi : rois_in_mosaic) {
    ReportCrop crop;
    crop.place = PlaceText(grid, roi, alignment.georeferenced());
    TREM_ASSIGN_OR_RETURN(const Image<float> made, mosaic(roi));
    const ValueRange range = QuantileRange(made, 0.01, 0.99);
    TREM_ASSIGN_OR_RETURN(crop.mosaic_png, GreyPng(made, range));
    TREM_ASSIGN_OR_RETURN(const std::optional<FramePlacement> best, BestFrame(manifest, frames, grid, roi));
    if (best) {
      TREM_ASSIGN_OR_RETURN(Image<float> pixels, reader->Read(best->index));
      Brighten(brightening, &pixels);
      for (float& value : pixels.pixels()) {
        const double internal = (value - manifest.grey_offset()) / manifest.grey_scale();
        value = static_cast<float>(manifest.grey_offset() + manifest.grey_scale() * (internal - best->offset) / best->gain);
      }
      const Homography sensor_from_mosaic = best->world_from_sensor.Inverse() * WorldFromPixel(grid);
      const Result<Homography> normalised = NormalisedAt(sensor_from_mosaic, {0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)});
      if (normalised.ok()) {
        TREM_ASSIGN_OR_RETURN(crop.frame_png, GreyPng(Resampled(std::move(pixels), image, *normalised, roi), range));
        crop.frame = manifest.frames(best->index).name();
      }
    }
    const Roi coarse = SensorRoi(grid, roi, sensor_grid);
    if (!coarse.empty()) {
      TREM_ASSIGN_OR_RETURN(const CompositeTile tile, baseline.Compose(sensor_grid, coarse, progress));
      const bool any = std::any_of(tile.count.pixels().begin(), tile.count.pixels().end(), [](float count) { return count > 0.0f; });
      if (any) {
        TREM_ASSIGN_OR_RETURN(crop.baseline_png, GreyPng(EnlargedOnto(grid, roi, sensor_grid, coarse, tile.median), range));
      }
    }
    crops.push_back(std::move(crop));
  }
  return crops;
}

}  // namespace trem
