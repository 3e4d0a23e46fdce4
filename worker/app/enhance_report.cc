#include "worker/app/enhance_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "mosaic/publish/scene_report.h"
#include "proto/codec/convert.h"
#include "worker/app/enhance_chain.h"

namespace trem {
namespace {

// Quantiles of the pictures' stretch.
constexpr double kTail = 0.005;
constexpr int kPictureSideMax = 900;

Image<float> ForPicture(const Image<float>& band) {
  Reduction reduction(band.width(), band.height(), kPictureSideMax);
  reduction.Add({0, 0, band.width(), band.height()}, band);
  return reduction.Picture();
}

Result<ScenePicture> Shown(const FloatBand& band, const std::string& title, const std::string& unit) {
  const Image<float> picture = ForPicture(band.pixels);
  ScenePicture shown;
  shown.title = title;
  shown.unit = unit;
  shown.picture.range = QuantileRange(picture, kTail, 1.0 - kTail);
  TREM_ASSIGN_OR_RETURN(shown.picture.png, unit.empty() ? GreyPng(picture, shown.picture.range) : ColourPng(picture, shown.picture.range));
  return shown;
}

double MedianOfSeen(const Image<float>& band) {
  std::vector<float> values;
  for (const float value : band.pixels()) {
    if (std::isfinite(value)) values.push_back(value);
  }
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The published chain's charts, over frame numbers; lines break where frames were lost or skipped.
class ChainCharts {
 public:
  ChainCharts(const EnhancedWindow& enhanced, const PublishedScene& published, const GreyScale& grey)
      : enhanced_(enhanced), published_(published), grey_(grey) {}

  Result<std::vector<LineChart>> Make() const {
    LineChart linear = Named("Affine coefficients (scene from sensor), less the ratio", "cells a px", {"a11", "a12", "a21", "a22"});
    LineChart place = Named(Tracked() ? "Place of the target in the sensor" : "Motion of the ROI over the scene", "sensor px", {"x", "y"});
    LineChart gain = Named("Gain against the scene", "", {"gain"});
    LineChart offset = Named("Offset against the scene", "grey levels", {"offset"});
    LineChart residual = Named("Residual (robust rms)", "grey levels", {"residual"});
    LineChart sigma = Named("Standard deviation of registration at a ROI corner", "sensor px", {"sigma"});
    LineChart fit = Named("Fit of the prediction", "", {"correlation", "overlap"});
    const Roi roi = FromProto(enhanced_.window->roi_in_sensor());
    const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
    const Eigen::Vector2d centre_in_scene = published_.pixel_from_sensor * centre;
    const double ratio = enhanced_.ratio;
    int last = -1;
    for (const v1::ChainView& view : published_.segment->chain()) {
      const int t = static_cast<int>(view.frame_index());
      if (last >= 0 && t > last + 1) {
        for (LineChart* chart : {&linear, &place, &gain, &offset, &residual, &sigma, &fit}) Break(last + 1, chart);
      }
      last = t;
      TREM_ASSIGN_OR_RETURN(const PlanarMap map, PixelFromSensor(view, *published_.scene));
      const Eigen::Matrix2d a = map.LinearisedAt(centre).linear;
      Add(t, {a(0, 0) - ratio, a(0, 1), a(1, 0), a(1, 1) - ratio}, &linear);
      // A target is where its centre is; a ROI fixed in the sensor looks where its own centre falls, counted from the reference frame.
      const Eigen::Vector2d at =
          Tracked() ? Eigen::Vector2d(map.Inverse() * centre_in_scene) : Eigen::Vector2d((map * centre - centre_in_scene) / ratio);
      Add(t, {at.x(), at.y()}, &place);
      Add(t, {view.gain()}, &gain);
      Add(t, {grey_.scale * view.offset() + grey_.offset * (1.0 - view.gain())}, &offset);
      Add(t, {view.correlation(), view.overlap()}, &fit);
      // The frame that started the scene is its gauge: it has neither residual nor uncertainty of its own.
      if (view.corner_covariance_px2_size() > 0 && view.corner_covariance_px2(0) <= kGaugeVariance) continue;
      Add(t, {grey_.scale * view.residual_rms()}, &residual);
      Add(t, {CornerSigma(view)}, &sigma);
    }
    return std::vector<LineChart>{linear, place, gain, offset, residual, sigma, fit};
  }

 private:
  static constexpr double kGaugeVariance = 1.01e-8;

  bool Tracked() const { return published_.reference->has_roi_in_sensor(); }

  static LineChart Named(const std::string& title, const std::string& unit, const std::vector<std::string>& names) {
    LineChart chart;
    chart.title = title;
    chart.x_label = "frame";
    chart.y_label = unit;
    for (const std::string& name : names) chart.lines.push_back({name, {}, {}});
    return chart;
  }

  static void Add(double t, const std::vector<double>& values, LineChart* chart) {
    for (std::size_t k = 0; k < values.size(); ++k) {
      chart->lines[k].x.push_back(t);
      chart->lines[k].y.push_back(values[k]);
    }
  }

  static void Break(double t, LineChart* chart) {
    for (ChartLine& line : chart->lines) {
      line.x.push_back(t);
      line.y.push_back(std::numeric_limits<double>::quiet_NaN());
    }
  }

  const EnhancedWindow& enhanced_;
  const PublishedScene& published_;
  const GreyScale& grey_;
};

LineChart ResolutionChart(const std::vector<ResolutionPoint>& points) {
  LineChart chart;
  chart.title = "Resolution against the number of frames (agreement of two halves)";
  chart.x_label = "frames";
  chart.y_label = "cycles a px";
  ChartLine line{"resolution", {}, {}};
  for (const ResolutionPoint& point : points) {
    line.x.push_back(point.frame_count);
    line.y.push_back(point.cycles_per_px);
  }
  chart.lines.push_back(std::move(line));
  return chart;
}

}  // namespace

Result<std::string> EnhanceReport(const EnhancedWindow& enhanced, const PublishedScene& published, const GreyScale& grey,
                                  const FloatRaster& scene, const std::string& comparison_png, const EnhanceSummary& summary) {
  SceneReport report;
  report.title = summary.outputs[0].filename().string();
  const bool tracked = published.reference->has_roi_in_sensor();
  const Roi roi = FromProto(enhanced.window->roi_in_sensor());
  report.summary = fmt::format("{} of {} frames made one scene of {}; reference frame {} ({}).", summary.registered_count,
                               summary.frame_count, tracked ? "a target that was followed" : "a ROI that is fixed in the sensor",
                               summary.reference_index, summary.reference_name);
  report.notes = summary.notes;
  ScenePicture comparison;
  comparison.title = "Left the reference frame, enlarged bicubically; right the scene in the same view and stretch of grey";
  comparison.picture.png = comparison_png;
  comparison.wide = true;
  report.pictures.push_back(std::move(comparison));
  const struct {
    const char* title;
    const char* unit;
  } bands[] = {{"Scene", ""},
               {"Standard deviation of the intensity's error", "grey levels"},
               {"Information", "frames, about"},
               {"Residual of the frames (robust rms)", "grey levels"}};
  for (std::size_t k = 0; k < scene.bands.size(); ++k) {
    TREM_ASSIGN_OR_RETURN(ScenePicture shown, Shown(scene.bands[k], bands[k].title, bands[k].unit));
    report.pictures.push_back(std::move(shown));
  }
  report.numbers = {
      {"Source", enhanced.manifest->source_path()},
      {"ROI in the sensor", fmt::format("{},{},{},{}", roi.x0, roi.y0, roi.width(), roi.height())},
      {"Frames", fmt::format("{}:{}; {} registered, {} lost, {} skipped", enhanced.window->frame_begin(), enhanced.window->frame_end(),
                             summary.registered_count, summary.lost_count, summary.skipped_count)},
      {"Scene",
       fmt::format("{} x {} pixels, {} a sensor pixel", scene.bands[0].pixels.width(), scene.bands[0].pixels.height(), enhanced.ratio)},
      {"Noise", fmt::format("{:.2f} grey levels", summary.noise_sigma)},
      {"Standard deviation of a scene pixel (median)", fmt::format("{:.2f} grey levels", MedianOfSeen(scene.bands[1].pixels))}};
  TREM_ASSIGN_OR_RETURN(report.charts, ChainCharts(enhanced, published, grey).Make());
  report.charts.push_back(ResolutionChart(summary.resolution));
  if (!summary.resolution.empty()) {
    const ResolutionPoint& last = summary.resolution.back();
    report.numbers.emplace_back(fmt::format("Resolution, {} frames", last.frame_count),
                                fmt::format("{:.2f} cycles a sensor pixel", last.cycles_per_px));
  }
  report.files = {
      {summary.outputs[0].filename().string(), "the scene: intensity, standard deviation, information, residual (float32)"},
      {summary.outputs[1].filename().string(), "every frame: transform, gain, offset, residual, covariances, or why it is missing"},
      {summary.outputs[2].filename().string(), "the first picture above"}};
  return RenderSceneReport(report);
}

}  // namespace trem
