#include "tests/bench/registration_scene.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/video/tracking.hpp>

#include "mosaic/base/rng.h"
#include "worker/sensor/blur.h"
#include "worker/tre/automatic_regularisation.h"
#include "worker/tre/information_update.h"

namespace trem::bench {
namespace {

constexpr int kRatio = 3;
// Truth around the scene, for the quadrature's support and turned frames.
constexpr int kBorderPx = 30;

Image<float> LoadTruth(const std::string& path, int width, int height) {
  const cv::Mat grey = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (grey.cols < width || grey.rows < height) {
    std::fprintf(stderr, "%s: expected a picture of at least %d x %d pixels, found %d x %d\n", path.c_str(), width, height, grey.cols,
                 grey.rows);
    std::exit(3);
  }
  const int left = (grey.cols - width) / 2;
  const int top = (grey.rows - height) / 2;
  Image<float> image(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) image.at(x, y) = grey.at<unsigned char>(top + y, left + x);
  }
  return image;
}

}  // namespace

RegistrationScene::RegistrationScene(const SceneOptions& options) : options_(options) {
  sequence_.roi_px = std::max(options.width, options.height);
  sequence_.psf_sigma_px = 0.6;
  sequence_.noise_sigma = options.noise_sigma;
  sequence_.seed = options.seed;
  roi_ = {0, 0, options.width, options.height};
  const int side = kRatio * (sequence_.roi_px + 2 * (options.margin_px + kBorderPx));
  truth_ = options.truth.empty() ? testing::ProceduralTruth(side, side, options.seed) : LoadTruth(options.truth, side, side);
  prediction_ = Image<float>(side, side);
  seen_ = Image<float>(side, side, 100.0F);
  if (options.settle_frames > 0) {
    Settle();
  } else {
    Blur(*MakePsf({sequence_.psf_sigma_px, sequence_.fill_factor}, kRatio)).Apply(truth_, &prediction_);
  }
}

void RegistrationScene::Settle() {
  constexpr int kFirstIterations = 20;
  constexpr int kFrameIterations = 4;
  constexpr double kSpreadPx = 6.0;  // Of the views, so that ground around the ROI is seen, too.
  constexpr std::uint64_t kStream = 1'000'000;
  const SeparablePsf psf = *MakePsf({sequence_.psf_sigma_px, sequence_.fill_factor}, kRatio);
  InformationUpdate update(Blur(psf), {});
  const AutomaticRegularisation regularisation(psf, StructurePriorKind::kHuberTv, kRatio, false);
  const Roi whole{0, 0, truth_.width(), truth_.height()};
  SceneBuffer buffer(whole);
  double mean = 0.0;
  for (const float cell : truth_.pixels()) mean += cell / static_cast<double>(truth_.pixels().size());
  std::fill(buffer.scene.pixels().begin(), buffer.scene.pixels().end(), static_cast<float>(mean));
  buffer.previous = buffer.scene;
  Rng rng({options_.seed, 73});
  for (int k = 0; k < options_.settle_frames; ++k) {
    CornerVector d(6);
    for (double& element : d) element = 0.5 * rng.Normal();
    const Eigen::Vector2d shift = kSpreadPx * Eigen::Vector2d(rng.Normal(), rng.Normal());
    for (int i = 0; i < 6; ++i) d(i) += shift(i % 2);
    const Frame frame = Render(d, kStream + static_cast<std::uint64_t>(k));
    update.Predict(whole, &buffer);
    update.AddFrame(Observe(frame), frame.truth, whole, &buffer);
    update.UpdateSeen(whole, kRatio, &buffer);
    const StructureWeight weight = regularisation.Weight(whole, buffer, options_.noise_sigma);
    update.set_prior({StructurePriorKind::kHuberTv, weight.delta});
    update.Iterate(whole, k == 0 ? kFirstIterations : kFrameIterations, weight.lambda, &buffer);
  }
  prediction_ = buffer.prediction;
  seen_ = buffer.seen;
}

View RegistrationScene::Nominal() const {
  View view;
  view.scene_from_sensor.linear *= kRatio;
  view.scene_from_sensor.offset.setConstant(kRatio * (options_.margin_px + kBorderPx));
  return view;
}

RegistrationScene::Window RegistrationScene::WindowAround(const View& view, double margin_px) const {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e9);
  Eigen::Vector2d high = -low;
  for (const int x : {roi_.x0, roi_.x1 - 1}) {
    for (const int y : {roi_.y0, roi_.y1 - 1}) {
      const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(x, y);
      low = low.cwiseMin(cell);
      high = high.cwiseMax(cell);
    }
  }
  Window window;
  window.x0 = std::max(0, static_cast<int>(std::floor(low.x() - kRatio * margin_px)));
  window.y0 = std::max(0, static_cast<int>(std::floor(low.y() - kRatio * margin_px)));
  const int x1 = std::min(prediction_.width(), static_cast<int>(std::ceil(high.x() + kRatio * margin_px)) + 1);
  const int y1 = std::min(prediction_.height(), static_cast<int>(std::ceil(high.y() + kRatio * margin_px)) + 1);
  window.prediction = Image<float>(x1 - window.x0, y1 - window.y0);
  window.seen = window.prediction;
  for (int y = window.y0; y < y1; ++y) {
    std::copy(prediction_.row(y) + window.x0, prediction_.row(y) + x1, window.prediction.row(y - window.y0));
    std::copy(seen_.row(y) + window.x0, seen_.row(y) + x1, window.seen.row(y - window.y0));
  }
  return window;
}

Frame RegistrationScene::Render(const CornerVector& d, std::uint64_t stream) const {
  Rng rng({options_.seed, 71, stream});
  Frame frame;
  frame.truth = {Displace(Nominal().scene_from_sensor, roi_, d), 1.0 + 0.03 * rng.Normal(), 3.0 * rng.Normal()};
  const PlanarMap& map = frame.truth.scene_from_sensor;
  const Image<float> square =
      testing::RenderFrame(truth_, sequence_, Affine{map.linear, map.offset}, frame.truth.gain, frame.truth.offset, stream);
  frame.pixels = Image<float>(roi_.width(), roi_.height());
  for (int v = 0; v < roi_.height(); ++v) std::copy(square.row(v), square.row(v) + roi_.width(), frame.pixels.row(v));
  return frame;
}

ViewPrior RegistrationScene::PriorAbout(const View& mean, double sigma_px) const {
  ViewPrior prior;
  prior.mean = {mean.scene_from_sensor, 1.0, 0.0};
  prior.information = CornerMatrix::Identity(6, 6) / (sigma_px * sigma_px);
  prior.gain_sigma = 0.1;
  prior.offset_sigma = 15.0;
  return prior;
}

CornerVector RigidDisplacement(const Roi& roi, const Eigen::Vector2d& shift_px, double rotation_rad) {
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  Eigen::Matrix2d turn;
  turn << std::cos(rotation_rad) - 1.0, -std::sin(rotation_rad), std::sin(rotation_rad), std::cos(rotation_rad) - 1.0;
  CornerVector d(6);
  d << turn * (Eigen::Vector2d(roi.x0, roi.y0) - centre) + shift_px, turn * (Eigen::Vector2d(roi.x1 - 1, roi.y0) - centre) + shift_px,
      turn * (Eigen::Vector2d(roi.x0, roi.y1 - 1) - centre) + shift_px;
  return d;
}

bool RegisterEcc(const Observation& observation, const Reference& reference, const View& start, View* view) {
  const auto as_mat = [](const Image<float>& image) {
    return cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0)));  // Only read from.
  };
  const PlanarMap& map = start.scene_from_sensor;
  // Template coordinates are the ROI's, input coordinates the reference's.
  const Eigen::Vector2d offset =
      map * Eigen::Vector2d(observation.roi.x0, observation.roi.y0) - Eigen::Vector2d(reference.x0, reference.y0);
  cv::Mat warp = (cv::Mat_<float>(2, 3) << map.linear(0, 0), map.linear(0, 1), offset.x(), map.linear(1, 0), map.linear(1, 1), offset.y());
  try {
    // No extra smoothing: the reference is blurred already, and it did better without.
    cv::findTransformECC(as_mat(*observation.roi_pixels), as_mat(*reference.prediction), warp, cv::MOTION_AFFINE,
                         cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 50, 1e-6), cv::noArray(), 1);
  } catch (const cv::Exception&) {
    return false;
  }
  *view = start;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) view->scene_from_sensor.linear(i, j) = warp.at<float>(i, j);
  }
  const Eigen::Vector2d found(warp.at<float>(0, 2) + reference.x0, warp.at<float>(1, 2) + reference.y0);
  view->scene_from_sensor.offset = found - view->scene_from_sensor.linear * Eigen::Vector2d(observation.roi.x0, observation.roi.y0);
  return true;
}

double ErrorPx(const View& view, const View& truth, const Roi& roi) {
  return LargestCornerMotion(view.scene_from_sensor, truth.scene_from_sensor, roi);
}

double Quantile(std::vector<double> values, double part) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(part * static_cast<double>(values.size())))];
}

double NowMs() { return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double CpuMs() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

}  // namespace trem::bench
