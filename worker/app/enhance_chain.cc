#include "worker/app/enhance_chain.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "mosaic/publish/chain_csv.h"
#include "proto/codec/convert.h"
#include "worker/tasks/outcome_name.h"

namespace trem {
namespace {

constexpr const char* kFrameColumns = "frame_index,frame,status,reason,segment";
constexpr const char* kFitColumns =
    ",scene_from_sensor_11,scene_from_sensor_12,scene_from_sensor_13,scene_from_sensor_21,scene_from_sensor_22,scene_from_sensor_23,"
    "scene_from_sensor_31,scene_from_sensor_32,gain,offset,residual_rms,correlation,overlap,corner_sigma_px,"
    "roi_x,roi_y,gain_variance,gain_offset_covariance,offset_variance";
constexpr int kFitColumnCount = 19;
constexpr const char* kCoordinates[] = {"ulx", "uly", "urx", "ury", "llx", "lly", "lrx", "lry"};

int ParameterCountOf(const v1::ChainView& view) { return view.corner_covariance_px2_size() == 36 ? 8 : 6; }

// Of the corners' covariance, as many as the largest view has.
int WidestTriangle(const v1::WindowResult& window) {
  int parameters = 6;
  for (const v1::Segment& segment : window.segments()) {
    for (const v1::ChainView& view : segment.chain()) parameters = std::max(parameters, ParameterCountOf(view));
  }
  return parameters;
}

std::string CovarianceHeader(int parameters) {
  std::string header;
  for (int row = 0; row < parameters; ++row) {
    for (int column = row; column < parameters; ++column) header += fmt::format(",cov_{}_{}", kCoordinates[row], kCoordinates[column]);
  }
  return header;
}

// The corners' covariance, spread over the columns of `parameters`.
std::string CovarianceColumns(const v1::ChainView& view, int parameters) {
  std::string columns;
  const int own = ParameterCountOf(view);
  int index = 0;
  for (int row = 0; row < parameters; ++row) {
    for (int column = row; column < parameters; ++column) {
      columns += ',';
      if (row < own && column < own && index < view.corner_covariance_px2_size())
        columns += fmt::format("{}", view.corner_covariance_px2(index++));
    }
  }
  return columns;
}

std::string FitColumns(const v1::ChainView& view, const PlanarMap& a, const Roi& window_roi, const GreyScale& grey) {
  const Roi roi = view.has_roi_in_sensor() ? FromProto(view.roi_in_sensor()) : window_roi;
  // source = scale * internal + grey.offset on both sides of frame = gain * scene + offset.
  const double offset = grey.scale * view.offset() + grey.offset * (1.0 - view.gain());
  std::string columns =
      fmt::format(",{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}", a.linear(0, 0), a.linear(0, 1), a.offset(0), a.linear(1, 0),
                  a.linear(1, 1), a.offset(1), a.perspective(0), a.perspective(1), view.gain(), offset, grey.scale * view.residual_rms(),
                  view.correlation(), view.overlap(), CornerSigma(view), roi.x0, roi.y0);
  if (view.gain_offset_covariance_size() < 3) return columns + ",,,";
  const double gain_gain = view.gain_offset_covariance(0);
  const double gain_offset = grey.scale * view.gain_offset_covariance(1) - grey.offset * gain_gain;
  const double offset_offset = grey.scale * grey.scale * view.gain_offset_covariance(2) + grey.offset * grey.offset * gain_gain -
                               2.0 * grey.scale * grey.offset * view.gain_offset_covariance(1);
  return columns + fmt::format(",{},{},{}", gain_gain, gain_offset, offset_offset);
}

}  // namespace

double CornerSigma(const v1::ChainView& view) {
  double largest = 0.0;
  int index = 0;
  const int parameters = ParameterCountOf(view);
  for (int row = 0; row < parameters; index += parameters - row, ++row) {
    if (index < view.corner_covariance_px2_size()) largest = std::max(largest, view.corner_covariance_px2(index));
  }
  return std::sqrt(largest);
}

Result<std::string> EnhanceChainCsv(const EnhancedWindow& enhanced, const PublishedScene& published, const GreyScale& grey) {
  const v1::WindowResult& window = *enhanced.window;
  const int parameters = WidestTriangle(window);
  std::string csv = kFrameColumns + std::string(kFitColumns) + CovarianceHeader(parameters) + "\n";
  std::multimap<std::uint32_t, std::string> fits;
  for (const v1::Segment& segment : window.segments()) {
    for (const v1::ChainView& view : segment.chain()) {
      TREM_ASSIGN_OR_RETURN(PlanarMap a, PlanarMapFromProto(view.scene_from_sensor(), "scene_from_sensor"));
      if (&segment == published.segment) {
        TREM_ASSIGN_OR_RETURN(a, PixelFromSensor(view, *published.scene));
      }
      fits.emplace(view.frame_index(), std::to_string(segment.segment_id()) + FitColumns(view, a, FromProto(window.roi_in_sensor()), grey) +
                                           CovarianceColumns(view, parameters));
    }
  }
  const std::string nothing(static_cast<std::size_t>(kFitColumnCount + parameters * (parameters + 1) / 2), ',');
  for (const v1::FrameOutcome& frame : window.frames()) {
    const std::string start =
        fmt::format("{},{},{},{},", frame.frame_index(), CsvField(enhanced.manifest->frames(static_cast<int>(frame.frame_index())).name()),
                    OutcomeName(frame.outcome()), CsvField(frame.reason()));
    const auto [begin, end] = fits.equal_range(frame.frame_index());
    if (begin == end) csv += start + nothing + "\n";
    for (auto fit = begin; fit != end; ++fit) csv += start + fit->second + "\n";
  }
  return csv;
}

}  // namespace trem
