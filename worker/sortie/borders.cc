#include "worker/sortie/borders.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// A line darker than this part of the frame's own brightness is black, in one frame.
constexpr double kBlack = 0.15;
// Part of the frames in which a border must be black. Not all: a decoder's grey filler frame must not hide it.
constexpr double kBlackFramesMin = 0.95;
// Mean brightness, relative to the picture beside it, up to which a line belongs to the fade between border and picture.
constexpr double kFade = 0.6;
constexpr int kFadeMax_px = 4;
constexpr int kBeside_px = 10;
constexpr double kSideMax = 0.3;  // Of the frame's side; more is content, not a border.
constexpr int kMargin_px = 2;

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Brightness of the picture: the median of the lines of the middle half.
double Reference(const std::vector<double>& lines) {
  const auto quarter = static_cast<std::ptrdiff_t>(lines.size() / 4);
  return Median(std::vector<double>(lines.begin() + quarter, lines.end() - quarter));
}

}  // namespace

BorderFinder::BorderFinder(int width_px, int height_px)
    : columns_(static_cast<std::size_t>(width_px)), rows_(static_cast<std::size_t>(height_px)) {
  TREM_CHECK(width_px > 0 && height_px > 0);
}

BorderFinder::LineMeans BorderFinder::MeansOf(const Image<float>& frame) {
  LineMeans means;
  std::vector<double>& columns = means.columns;
  columns.assign(static_cast<std::size_t>(frame.width()), 0.0);
  for (int y = 0; y < frame.height(); ++y) {
    const float* row = frame.row(y);
    double sum = 0.0;
    for (std::size_t x = 0; x < columns.size(); ++x) {
      columns[x] += row[x];
      sum += row[x];
    }
    means.rows.push_back(sum / frame.width());
  }
  for (double& column : columns) column /= frame.height();
  return means;
}

void BorderFinder::Add(const LineMeans& means) {
  TREM_CHECK(means.columns.size() == columns_.size() && means.rows.size() == rows_.size());
  const double reference = std::min(Reference(means.columns), Reference(means.rows));
  if (!(reference > 1e-6)) return;  // A black frame says nothing about its edges.
  ++frame_count_;
  const auto note = [reference](const std::vector<double>& brightness, std::vector<Line>* lines) {
    for (std::size_t i = 0; i < brightness.size(); ++i) {
      const double relative = brightness[i] / reference;
      (*lines)[i].relative_sum += relative;
      (*lines)[i].black_count += relative < kBlack ? 1 : 0;
    }
  };
  note(means.columns, &columns_);
  note(means.rows, &rows_);
}

int BorderFinder::BorderWidth(const std::vector<Line>& lines) const {
  const auto limit = static_cast<std::size_t>(kSideMax * static_cast<double>(lines.size()));
  std::size_t border = 0;
  while (border < limit && lines[border].black_count >= kBlackFramesMin * frame_count_) ++border;
  if (border >= limit || lines.size() < 4 * (kBeside_px + kFadeMax_px)) return 0;
  std::vector<double> beside;
  for (std::size_t i = border + kFadeMax_px; i < border + kFadeMax_px + kBeside_px; ++i) beside.push_back(lines[i].relative_sum);
  const double picture = Median(beside);
  std::size_t faded = border;
  while (faded < border + kFadeMax_px && lines[faded].relative_sum < kFade * picture) ++faded;
  // Lines as dark as a fade right up to the last one looked at are a gradient of the scene.
  if (faded == border + kFadeMax_px) faded = border;
  return faded == 0 ? 0 : static_cast<int>(faded) + kMargin_px;
}

BorderFinder::Finding BorderFinder::Find() const {
  const int width = static_cast<int>(columns_.size());
  const int height = static_cast<int>(rows_.size());
  Finding finding{{0, 0, width, height}, ""};
  if (frame_count_ == 0) return finding;
  const int left = BorderWidth(columns_);
  const int right = BorderWidth({columns_.rbegin(), columns_.rend()});
  const int top = BorderWidth(rows_);
  const int bottom = BorderWidth({rows_.rbegin(), rows_.rend()});
  finding.valid_roi = {left, top, width - right, height - bottom};
  const auto add = [&finding](int count, const char* what, const char* side) {
    if (count == 0) return;
    if (!finding.note.empty()) finding.note += ", ";
    finding.note += std::to_string(count) + " " + what + " at the " + side;
  };
  add(left, "columns", "left");
  add(right, "columns", "right");
  add(top, "rows", "top");
  add(bottom, "rows", "bottom");
  return finding;
}

}  // namespace trem
