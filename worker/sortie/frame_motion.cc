#include "worker/sortie/frame_motion.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <vector>

namespace trem {
namespace {

constexpr int kLevels = 3;
// Sides of the pyramid's levels, coarse to fine.
constexpr std::array<int, kLevels> kLevelSide_px = {96, 192, 384};
constexpr int kValidationLevel = 1;
// The band that carries structure at every level: noise above, shading below.
constexpr double kBandLow_px = 0.8;
constexpr double kBandHigh_px = 7.0;
constexpr double kClipSigmas = 4.0;

// Unrelated frames reach about 0.2 when six parameters are free to choose (measured on frames far apart of real sorties).
constexpr double kCorrelationMin = 0.35;
// Below this the feature search gets a chance to do better.
constexpr double kCorrelationGood = 0.6;
// Of the frame's longer side: two pixels of the level at which phases are correlated.
constexpr double kAgreement = 0.01;
constexpr double kOverlapMin = 0.25;
constexpr double kScaleMin = 0.5;
constexpr double kScaleMax = 2.0;
constexpr double kShearMax = 1.6;  // Ratio of the singular values of the linear part.

constexpr int kFeatureInliersMin = 10;
constexpr std::uint64_t kRansacSeed = 20;

cv::Mat ToMat(const Image<float>& image) {
  // A header over the image's own pixels, which OpenCV only reads here.
  return cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0)));
}

cv::Mat BandPass(const cv::Mat& image) {
  cv::Mat low, high, band;
  cv::GaussianBlur(image, low, cv::Size(), kBandHigh_px, kBandHigh_px, cv::BORDER_REFLECT);
  cv::GaussianBlur(image, high, cv::Size(), kBandLow_px, kBandLow_px, cv::BORDER_REFLECT);
  band = high - low;
  cv::Scalar mean, sigma;
  cv::meanStdDev(band, mean, sigma);
  // Movers and hot spots must not outweigh the ground.
  const double limit = kClipSigmas * std::max(sigma[0], 1e-6);
  cv::min(band, limit, band);
  cv::max(band, -limit, band);
  return band;
}

cv::Mat ToMat(const Affine& affine) {
  return (cv::Mat_<float>(2, 3) << affine.linear(0, 0), affine.linear(0, 1), affine.offset(0), affine.linear(1, 0), affine.linear(1, 1),
          affine.offset(1));
}

Affine ToAffine(const cv::Mat& matrix) {
  cv::Mat_<double> m;
  matrix.convertTo(m, CV_64F);
  Affine affine;
  affine.linear << m(0, 0), m(0, 1), m(1, 0), m(1, 1);
  affine.offset << m(0, 2), m(1, 2);
  return affine;
}

bool IsPlausible(const Affine& affine) {
  if (!affine.linear.allFinite() || !affine.offset.allFinite() || affine.linear.determinant() <= 0.0) return false;
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(affine.linear);
  const double large = svd.singularValues()(0);
  const double small = svd.singularValues()(1);
  return small >= kScaleMin && large <= kScaleMax && large <= kShearMax * small;
}

struct Score {
  double correlation = -1.0;
  double overlap = 0.0;
};

// Normalised correlation of `current` with `previous` warped onto it.
Score Correlate(const cv::Mat& previous, const cv::Mat& current, const Affine& previous_from_current) {
  const cv::Mat matrix = ToMat(previous_from_current);
  cv::Mat warped, mask;
  cv::warpAffine(previous, warped, matrix, current.size(), cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
  const cv::Mat ones(previous.size(), CV_8U, cv::Scalar(255));
  cv::warpAffine(ones, mask, matrix, current.size(), cv::INTER_NEAREST | cv::WARP_INVERSE_MAP);
  Score score;
  score.overlap = static_cast<double>(cv::countNonZero(mask)) / static_cast<double>(mask.total());
  if (score.overlap < 0.01) return score;
  cv::Scalar mean_a, sigma_a, mean_b, sigma_b;
  cv::meanStdDev(warped, mean_a, sigma_a, mask);
  cv::meanStdDev(current, mean_b, sigma_b, mask);
  if (sigma_a[0] < 1e-6 || sigma_b[0] < 1e-6) return score;
  cv::Mat product = (warped - mean_a[0]).mul(current - mean_b[0]);
  score.correlation = cv::mean(product, mask)[0] / (sigma_a[0] * sigma_b[0]);
  return score;
}

// Refines *previous_from_current; false when ECC diverges.
bool Refine(const cv::Mat& previous, const cv::Mat& current, int motion, int iterations, Affine* previous_from_current) {
  cv::Mat matrix = ToMat(*previous_from_current);
  try {
    const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, iterations, 1e-4);
    cv::findTransformECC(current, previous, matrix, motion, criteria, cv::noArray(), 1);
  } catch (const cv::Exception&) {
    return false;  // The images are uncorrelated from here, or the Hessian is singular.
  }
  const Affine refined = ToAffine(matrix);
  if (!IsPlausible(refined)) return false;
  *previous_from_current = refined;
  return true;
}

}  // namespace

// One frame's pyramid and, when they were needed, its features.
struct Pyramid {
  std::array<cv::Mat, kLevels> levels;  // Band-passed.
  cv::Mat picture;                      // 8 bits, for features.
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  bool has_features = false;
};

struct FrameMotion::State {
  int width_px = 0;
  int height_px = 0;
  Roi valid_roi;
  std::optional<Pyramid> previous;
  Affine velocity;  // Last previous_from_current, sensor pixels.

  // Full resolution from a level's pixel coordinates.
  std::array<Affine, kLevels> sensor_from_level;

  Pyramid Build(const Image<float>& reduced);
  Affine ToLevel(const Affine& sensor, int level) const {
    const Affine& from = sensor_from_level[static_cast<std::size_t>(level)];
    return from.Inverse() * sensor * from;
  }
  Affine FromLevel(const Affine& affine, int level) const {
    const Affine& from = sensor_from_level[static_cast<std::size_t>(level)];
    return from * affine * from.Inverse();
  }
  // Follows a start (sensor pixels) through the pyramid up to the validation level.
  Score Climb(const Pyramid& current, Affine* motion, int first_level) const;
  Affine PhaseShift(const Pyramid& current) const;
  // Whether two motions, found independently, put the image centre to the same place.
  bool Agree(const Affine& a, const Affine& b) const;
  std::optional<Affine> FeatureMotion(Pyramid* current);
};

namespace {

void FindFeatures(Pyramid* pyramid) {
  if (pyramid->has_features) return;
  cv::SIFT::create(600, 3, 0.02)->detectAndCompute(pyramid->picture, cv::noArray(), pyramid->keypoints, pyramid->descriptors);
  pyramid->has_features = true;
}

}  // namespace

Image<float> ReduceFrame(const Image<float>& frame) {
  const int longer = std::max(frame.width(), frame.height());
  if (longer <= kReducedSide_px) return frame;
  const double factor = static_cast<double>(kReducedSide_px) / longer;
  Image<float> reduced(std::max(1, static_cast<int>(std::lround(frame.width() * factor))),
                       std::max(1, static_cast<int>(std::lround(frame.height() * factor))));
  cv::Mat out(reduced.height(), reduced.width(), CV_32F, reduced.row(0));
  cv::resize(ToMat(frame), out, out.size(), 0, 0, cv::INTER_AREA);
  return reduced;
}

FrameMotion::FrameMotion(int width_px, int height_px, const Roi& valid_roi) : state_(std::make_unique<State>()) {
  state_->width_px = width_px;
  state_->height_px = height_px;
  state_->valid_roi = valid_roi;
}
FrameMotion::~FrameMotion() = default;
FrameMotion::FrameMotion(FrameMotion&&) noexcept = default;
FrameMotion& FrameMotion::operator=(FrameMotion&&) noexcept = default;

Pyramid FrameMotion::State::Build(const Image<float>& reduced) {
  const double sx = static_cast<double>(width_px) / reduced.width();
  const double sy = static_cast<double>(height_px) / reduced.height();
  const int x0 = std::min(static_cast<int>(std::ceil(valid_roi.x0 / sx)), reduced.width() - 1);
  const int y0 = std::min(static_cast<int>(std::ceil(valid_roi.y0 / sy)), reduced.height() - 1);
  const int x1 = std::clamp(static_cast<int>(std::floor(valid_roi.x1 / sx)), x0 + 1, reduced.width());
  const int y1 = std::clamp(static_cast<int>(std::floor(valid_roi.y1 / sy)), y0 + 1, reduced.height());
  const cv::Mat valid = ToMat(reduced)(cv::Rect(x0, y0, x1 - x0, y1 - y0));
  Pyramid pyramid;
  for (int level = 0; level < kLevels; ++level) {
    const auto l = static_cast<std::size_t>(level);
    const double factor = std::min(1.0, static_cast<double>(kLevelSide_px[l]) / std::max(valid.cols, valid.rows));
    const cv::Size size(std::max(8, static_cast<int>(std::lround(valid.cols * factor))),
                        std::max(8, static_cast<int>(std::lround(valid.rows * factor))));
    cv::Mat averaged;
    cv::resize(valid, averaged, size, 0, 0, cv::INTER_AREA);
    pyramid.levels[l] = BandPass(averaged);
    // Pixel edges map to pixel edges: x_sensor + 1/2 = s * (x0 + t * (x_level + 1/2)).
    const double tx = sx * valid.cols / size.width;
    const double ty = sy * valid.rows / size.height;
    sensor_from_level[l].linear = Eigen::Vector2d(tx, ty).asDiagonal();
    sensor_from_level[l].offset = {sx * x0 + 0.5 * tx - 0.5, sy * y0 + 0.5 * ty - 0.5};
  }
  cv::normalize(pyramid.levels[kLevels - 1], pyramid.picture, 0, 255, cv::NORM_MINMAX, CV_8U);
  return pyramid;
}

Score FrameMotion::State::Climb(const Pyramid& current, Affine* motion, int first_level) const {
  for (int level = first_level; level <= kValidationLevel; ++level) {
    const auto l = static_cast<std::size_t>(level);
    Affine affine = ToLevel(*motion, level);
    if (level == 0) Refine(previous->levels[l], current.levels[l], cv::MOTION_EUCLIDEAN, 25, &affine);
    if (Refine(previous->levels[l], current.levels[l], cv::MOTION_AFFINE, level == 0 ? 25 : 15, &affine))
      *motion = FromLevel(affine, level);
  }
  return Correlate(previous->levels[kValidationLevel], current.levels[kValidationLevel], ToLevel(*motion, kValidationLevel));
}

Affine FrameMotion::State::PhaseShift(const Pyramid& current) const {
  constexpr std::size_t kLevel = 1;
  cv::Mat window;
  cv::createHanningWindow(window, current.levels[kLevel].size(), CV_32F);
  const cv::Point2d shift = cv::phaseCorrelate(current.levels[kLevel], previous->levels[kLevel], window);
  Affine affine;
  affine.offset = {shift.x, shift.y};
  return FromLevel(affine, kLevel);
}

bool FrameMotion::State::Agree(const Affine& a, const Affine& b) const {
  const Eigen::Vector2d centre(0.5 * (width_px - 1.0), 0.5 * (height_px - 1.0));
  return (a * centre - b * centre).norm() <= kAgreement * std::max(width_px, height_px);
}

std::optional<Affine> FrameMotion::State::FeatureMotion(Pyramid* current) {
  FindFeatures(&*previous);
  FindFeatures(current);
  if (previous->descriptors.rows < kFeatureInliersMin || current->descriptors.rows < kFeatureInliersMin) return std::nullopt;
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(current->descriptors, previous->descriptors, matches, 2);
  std::vector<cv::Point2f> from, to;
  for (const auto& match : matches) {
    if (match.size() < 2 || match[0].distance > 0.8F * match[1].distance) continue;
    from.push_back(current->keypoints[static_cast<std::size_t>(match[0].queryIdx)].pt);
    to.push_back(previous->keypoints[static_cast<std::size_t>(match[0].trainIdx)].pt);
  }
  if (from.size() < static_cast<std::size_t>(kFeatureInliersMin)) return std::nullopt;
  cv::setRNGSeed(static_cast<int>(kRansacSeed));
  std::vector<std::uint8_t> inliers;
  const cv::Mat matrix = cv::estimateAffine2D(from, to, inliers, cv::RANSAC, 3.0, 3000, 0.99, 10);
  if (matrix.empty() || std::count(inliers.begin(), inliers.end(), 1) < kFeatureInliersMin) return std::nullopt;
  const Affine affine = ToAffine(matrix);
  if (!IsPlausible(affine)) return std::nullopt;
  return FromLevel(affine, kLevels - 1);
}

std::optional<MotionLink> FrameMotion::Link(const Image<float>& reduced) {
  State& state = *state_;
  Pyramid current = state.Build(reduced);
  if (!state.previous.has_value()) {
    state.previous = std::move(current);
    return std::nullopt;
  }
  Affine best;
  Score best_score;
  const auto consider = [&](Affine motion, int first_level) {
    const Score score = state.Climb(current, &motion, first_level);
    if (score.overlap < kOverlapMin || !IsPlausible(motion) || score.correlation <= best_score.correlation) return;
    best = motion;
    best_score = score;
  };
  consider(state.velocity, 0);
  const Affine shift = state.PhaseShift(current);
  if (best_score.correlation < kCorrelationGood || !state.Agree(best, shift)) {
    consider(shift, 0);
    consider(Affine(), 0);
  }
  if (best_score.correlation < kCorrelationGood) {
    const std::optional<Affine> start = state.FeatureMotion(&current);
    if (start.has_value()) consider(*start, kValidationLevel);
  }
  std::optional<MotionLink> link;
  if (best_score.correlation >= kCorrelationMin) {
    constexpr int kFinest = kLevels - 1;
    Affine fine = state.ToLevel(best, kFinest);
    if (Refine(state.previous->levels[kFinest], current.levels[kFinest], cv::MOTION_AFFINE, 8, &fine)) {
      const Affine refined = state.FromLevel(fine, kFinest);
      const Score score =
          Correlate(state.previous->levels[kValidationLevel], current.levels[kValidationLevel], state.ToLevel(refined, kValidationLevel));
      if (score.correlation > best_score.correlation - 0.02) best = refined;
    }
    link = MotionLink{best, std::min(1.0, best_score.correlation), best_score.overlap};
  }
  state.velocity = link.has_value() ? best : Affine();
  state.previous = std::move(current);
  return link;
}

}  // namespace trem
