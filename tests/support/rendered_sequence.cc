#include "tests/support/rendered_sequence.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "mosaic/base/rng.h"
#include "worker/sensor/bicubic.h"

namespace trem::testing {
namespace {

constexpr int kStepsPerPixel = 4;  // Of the quadrature.
constexpr int kBorderPx = 20;      // Of truth around all that is seen.
constexpr std::size_t kSamplesMin = 2000;

struct Quadrature {
  int side = 0;                 // Nodes on each side of the pixel's centre.
  std::vector<double> weights;  // 2 side + 1; sum to 1.
};

// Of the Gaussian convolved with the detector's box, along one axis.
Quadrature PixelQuadrature(double sigma_px, double fill_factor) {
  const double half_box = 0.5 * fill_factor;
  const auto cdf = [](double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); };
  Quadrature q;
  q.side = static_cast<int>(std::ceil((3.5 * sigma_px + half_box) * kStepsPerPixel));
  double total = 0.0;
  for (int i = -q.side; i <= q.side; ++i) {
    const double x = static_cast<double>(i) / kStepsPerPixel;
    q.weights.push_back(cdf((x + half_box) / sigma_px) - cdf((x - half_box) / sigma_px));
    total += q.weights.back();
  }
  for (double& weight : q.weights) weight /= total;
  return q;
}

// How far the ROI's centre travels along x, and room for turned corners.
double TravelPx(const SequenceOptions& o) { return o.motion == CameraMotion::kPath ? o.speed_px * o.frame_count : 0.0; }
double TurnedRoiPx(const SequenceOptions& o) { return o.roi_px * (o.turn_rad > 0.0 ? std::sqrt(2.0) : 1.0); }

Affine PathView(const SequenceOptions& o, int t) {
  const double angle = 0.01 * std::sin(0.05 * t) + o.turn_rad * t;
  const double scale = o.cells_per_pixel * (1.0 + 0.01 * std::sin(0.031 * t));
  Affine truth_from_sensor;
  truth_from_sensor.linear << scale * std::cos(angle), -1.02 * scale * std::sin(angle), scale * std::sin(angle), scale * std::cos(angle);
  const Eigen::Vector2d centre = Eigen::Vector2d::Constant(0.5 * (o.roi_px - 1));
  const Eigen::Vector2d start(o.cells_per_pixel * (0.5 * TurnedRoiPx(o) + kBorderPx), 0.5 * TruthHeight(o));
  const Eigen::Vector2d path_px(o.speed_px * t + 0.3 * std::sin(1.7 * t), 4.0 * std::sin(0.11 * t) + 0.4 * std::sin(2.3 * t));
  truth_from_sensor.offset = start + o.cells_per_pixel * path_px - truth_from_sensor.linear * centre;
  return truth_from_sensor;
}

std::vector<Affine> DwellViews(const SequenceOptions& o) {
  constexpr double kKeep = 0.9;  // Of the distance from the place looked at, a frame.
  constexpr double kStepPx = 0.5;
  constexpr double kStepLinear = 0.002 * 0.436;  // sqrt(1 - kKeep^2): 0.002 in all.
  Rng rng({o.seed, 13});
  Eigen::Matrix2d linear = Eigen::Matrix2d::Zero();
  Eigen::Vector2d walk_px = Eigen::Vector2d::Zero();
  const Eigen::Vector2d centre = Eigen::Vector2d::Constant(0.5 * (o.roi_px - 1));
  const Eigen::Vector2d corner = Eigen::Vector2d::Constant(kBorderPx);
  const Eigen::Vector2d drift_px = o.speed_px * Eigen::Vector2d(0.8, 0.6);
  std::vector<Affine> views;
  for (int t = 0; t < o.frame_count; ++t) {
    Affine truth_from_sensor;
    truth_from_sensor.linear = o.cells_per_pixel * (Eigen::Matrix2d::Identity() + linear);
    truth_from_sensor.offset = o.cells_per_pixel * (corner + centre + walk_px + t * drift_px) - truth_from_sensor.linear * centre;
    views.push_back(truth_from_sensor);
    walk_px = kKeep * walk_px + kStepPx * Eigen::Vector2d{rng.Normal(), rng.Normal()};
    for (double& element : linear.reshaped()) element = kKeep * element + kStepLinear * rng.Normal();
  }
  return views;
}

std::vector<Affine> TrueViews(const SequenceOptions& o) {
  if (o.motion == CameraMotion::kDwell) return DwellViews(o);
  std::vector<Affine> views;
  for (int t = 0; t < o.frame_count; ++t) views.push_back(PathView(o, t));
  return views;
}

// True when all cells that a cubic sample at (x, y) uses have been seen by [seen_min, seen_max) frames.
bool SeenBy(const SceneSnapshot& snapshot, const Eigen::Vector2d& x, double seen_min, double seen_max) {
  if (!CubicSupported(snapshot.intensity, x.x(), x.y())) return false;
  const int ix = static_cast<int>(x.x());
  const int iy = static_cast<int>(x.y());
  for (int j = -1; j <= 2; ++j) {
    for (int i = -1; i <= 2; ++i) {
      const float seen = snapshot.information.at(ix + i, iy + j);
      if (!(seen > 0.0F && seen >= seen_min && seen < seen_max)) return false;
    }
  }
  return true;
}

}  // namespace

Affine RenderedSequence::TruthFromScene(int first, int ratio) const {
  Affine scene_from_sensor;
  scene_from_sensor.linear *= ratio;
  return truth_from_sensor[static_cast<std::size_t>(first)] * scene_from_sensor.Inverse();
}

int TruthWidth(const SequenceOptions& o) { return static_cast<int>(o.cells_per_pixel * (TurnedRoiPx(o) + TravelPx(o) + 2 * kBorderPx)); }

int TruthHeight(const SequenceOptions& o) { return static_cast<int>(o.cells_per_pixel * (TurnedRoiPx(o) + 2 * kBorderPx)); }

Eigen::Vector2d FirstDwellCorner(const SequenceOptions& o) { return Eigen::Vector2d::Constant(o.cells_per_pixel * kBorderPx); }

Image<float> ProceduralTruth(int width, int height, std::uint64_t seed) {
  cv::Mat canvas(height, width, CV_32F, cv::Scalar(110));
  Rng rng({seed, 77});
  for (int i = 0; i < width * height / 2500; ++i) {
    const float x = static_cast<float>(rng.Uniform() * width);
    const float y = static_cast<float>(rng.Uniform() * height);
    const float length = static_cast<float>(6 + 60 * rng.Uniform());
    const float breadth = static_cast<float>(3 + 30 * rng.Uniform());
    const cv::RotatedRect rectangle({x, y}, {length, breadth}, static_cast<float>(180 * rng.Uniform()));
    cv::Point2f corners[4];
    rectangle.points(corners);
    std::vector<cv::Point> polygon;
    for (const cv::Point2f& c : corners) polygon.emplace_back(static_cast<int>(c.x * 16), static_cast<int>(c.y * 16));
    cv::fillConvexPoly(canvas, polygon, cv::Scalar(40 + 180 * rng.Uniform()), cv::LINE_8, 4);
  }
  Image<float> truth(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) truth.at(x, y) = canvas.at<float>(y, x) + static_cast<float>(4.0 * rng.Normal());
  }
  return truth;
}

Image<float> Filtered121(const Image<float>& image) {
  Image<float> out(image.width(), image.height());
  for (int y = 1; y + 1 < image.height(); ++y) {
    for (int x = 1; x + 1 < image.width(); ++x) {
      float sum = 0.0F;
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) sum += image.at(x + i, y + j) * static_cast<float>((2 - std::abs(i)) * (2 - std::abs(j)));
      }
      out.at(x, y) = sum / 16.0F;
    }
  }
  return out;
}

Image<float> RenderFrame(const Image<float>& truth, const SequenceOptions& o, const Affine& truth_from_sensor, double gain, double offset,
                         std::uint64_t stream) {
  const Quadrature q = PixelQuadrature(o.psf_sigma_px, o.fill_factor);
  const int fine_px = (o.roi_px - 1) * kStepsPerPixel + 2 * q.side + 1;
  // The pixels' nodes lie on one grid: the truth is sampled there once, then summed along rows and along columns.
  Image<double> rows(o.roi_px, fine_px);
  std::vector<double> fine(static_cast<std::size_t>(fine_px));
  for (int j = 0; j < fine_px; ++j) {
    for (int i = 0; i < fine_px; ++i) {
      const Eigen::Vector2d x = truth_from_sensor * (Eigen::Vector2d(i - q.side, j - q.side) / kStepsPerPixel);
      TREM_CHECK(CubicSupported(truth, x.x(), x.y()));
      fine[static_cast<std::size_t>(i)] = SampleCubic(truth, x.x(), x.y());
    }
    for (int u = 0; u < o.roi_px; ++u) {
      double sum = 0.0;
      for (std::size_t k = 0; k < q.weights.size(); ++k) sum += q.weights[k] * fine[static_cast<std::size_t>(u * kStepsPerPixel) + k];
      rows.at(u, j) = sum;
    }
  }
  Rng rng({o.seed, 5, stream});
  Image<float> frame(o.roi_px, o.roi_px);
  for (int v = 0; v < o.roi_px; ++v) {
    for (int u = 0; u < o.roi_px; ++u) {
      double sum = 0.0;
      for (std::size_t k = 0; k < q.weights.size(); ++k) sum += q.weights[k] * rows.at(u, v * kStepsPerPixel + static_cast<int>(k));
      frame.at(u, v) = static_cast<float>(gain * sum + offset + o.noise_sigma * rng.Normal());
    }
  }
  return frame;
}

RenderedSequence RenderSequence(Image<float> truth, const SequenceOptions& o) {
  RenderedSequence s;
  s.truth = std::move(truth);
  s.roi = {0, 0, o.roi_px, o.roi_px};
  Rng motion_rng({o.seed, 9});
  const std::vector<Affine> views = TrueViews(o);
  for (int t = 0; t < o.frame_count; ++t) {
    const Affine view = views[static_cast<std::size_t>(t)];
    s.gains.push_back(1.0 + o.gain_swing * std::sin(0.07 * t));
    s.offsets.push_back(o.offset_swing * std::sin(0.05 * t));
    FrameInput frame;
    frame.frame_index = t;
    frame.pixels = RenderFrame(s.truth, o, view, s.gains.back(), s.offsets.back(), static_cast<std::uint64_t>(t));
    if (t > 0) {
      Affine motion = s.truth_from_sensor.back().Inverse() * view;
      motion.offset += o.motion_sigma_px * Eigen::Vector2d(motion_rng.Normal(), motion_rng.Normal());
      frame.previous_from_current = motion;
    }
    s.frames.push_back(std::move(frame));
    s.truth_from_sensor.push_back(view);
  }
  return s;
}

RenderedSequence RenderSequence(const SequenceOptions& options) {
  return RenderSequence(ProceduralTruth(TruthWidth(options), TruthHeight(options), options.seed), options);
}

std::optional<double> Psnr(const std::vector<double>& x, const std::vector<double>& y) {
  if (x.size() < kSamplesMin) return std::nullopt;
  double sx = 0.0, sy = 0.0, sxx = 0.0, sxy = 0.0;
  const double n = static_cast<double>(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    sx += x[i];
    sy += y[i];
    sxx += x[i] * x[i];
    sxy += x[i] * y[i];
  }
  const double gain = (n * sxy - sx * sy) / (n * sxx - sx * sx);
  const double offset = (sy - gain * sx) / n;
  double squares = 0.0;
  for (std::size_t i = 0; i < x.size(); ++i) squares += std::pow(gain * x[i] + offset - y[i], 2);
  return 10.0 * std::log10(255.0 * 255.0 * n / squares);
}

SnapshotScore ScoreSnapshot(const RenderedSequence& sequence, const Image<float>& filtered_truth, const SceneSnapshot& snapshot, int first,
                            double seen_min, double seen_max) {
  const Affine scene_from_truth = sequence.TruthFromScene(first).Inverse();
  const Affine sensor_from_truth = sequence.truth_from_sensor[static_cast<std::size_t>(first)].Inverse();
  const Image<float>& frame = sequence.frames[static_cast<std::size_t>(first)].pixels;
  std::vector<double> scene, scene_truth, bicubic, bicubic_truth;
  for (int y = 1; y + 1 < filtered_truth.height(); ++y) {
    for (int x = 1; x + 1 < filtered_truth.width(); ++x) {
      const Eigen::Vector2d cell = scene_from_truth * Eigen::Vector2d(x, y) - Eigen::Vector2d(snapshot.extent.x0, snapshot.extent.y0);
      if (SeenBy(snapshot, cell, seen_min, seen_max)) {
        scene.push_back(SampleCubic(snapshot.intensity, cell.x(), cell.y()));
        scene_truth.push_back(filtered_truth.at(x, y));
      }
      const Eigen::Vector2d u = sensor_from_truth * Eigen::Vector2d(x, y);
      if (CubicSupported(frame, u.x(), u.y())) {
        bicubic.push_back(SampleCubic(frame, u.x(), u.y()));
        bicubic_truth.push_back(filtered_truth.at(x, y));
      }
    }
  }
  return {Psnr(scene, scene_truth), Psnr(bicubic, bicubic_truth)};
}

double CornerError(const RenderedSequence& sequence, const ChainEntry& entry, int first) {
  const Affine expected =
      sequence.TruthFromScene(first).Inverse() * sequence.truth_from_sensor[static_cast<std::size_t>(entry.frame_index)];
  return LargestCornerMotion(entry.registration.view.scene_from_sensor, expected, sequence.roi);
}

}  // namespace trem::testing
