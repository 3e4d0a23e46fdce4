#include "worker/sortie/vignetting.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

namespace trem {
namespace {

constexpr int kBlocks = 48;              // Along the image's shorter side.
constexpr int kPatchBlocks = 3;          // Along a patch.
constexpr double kKeyPart = 1.0 / 12.0;  // Motion between key frames, of the shorter side.
constexpr std::size_t kLags = 6;         // Key frames before the current one that it is compared with.
constexpr std::size_t kGroupsMax = 128;
constexpr std::size_t kGroupsMin = 6;
constexpr std::size_t kPlacesMin = 24;
constexpr double kDarkPart = 0.02;   // Of level_max: darker patches say more of the offset than of the gain.
constexpr double kPriorSigma = 0.5;  // Of both coefficients.
constexpr int kRounds = 6;
constexpr double kTukey = 4.685;
// Neighbouring key frames share partners, so that their pairs err alike.
constexpr double kErrorFactor = 1.5;
constexpr double kSeenSigmas = 5.0;
constexpr double kSeenLeast = 0.015;  // Part of the light.
constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

}  // namespace

double RadialVignetting::At(double r2) const { return std::exp(r2 * (second + r2 * fourth)); }

bool VignettingEstimate::Seen() const {
  const double log_corner = std::abs(vignetting.second + vignetting.fourth);
  return log_corner > kSeenLeast && log_corner > kSeenSigmas * corner_error;
}

VignettingFinder::VignettingFinder(int width_px, int height_px, const Roi& valid_roi, double level_max)
    : size_px_(width_px, height_px), valid_roi_(valid_roi), level_max_(level_max) {}

Image<float> VignettingFinder::PatchesOf(const Image<float>& reduced) const {
  const int side = std::max(1, std::min(reduced.width(), reduced.height()) / kBlocks);
  Image<float> blocks(reduced.width() / side, reduced.height() / side);
  const double sx = size_px_.x() / reduced.width(), sy = size_px_.y() / reduced.height();
  for (int row = 0; row < blocks.height(); ++row) {
    for (int column = 0; column < blocks.width(); ++column) {
      const bool valid = sx * column * side >= valid_roi_.x0 && sx * (column + 1) * side <= valid_roi_.x1 &&
                         sy * row * side >= valid_roi_.y0 && sy * (row + 1) * side <= valid_roi_.y1;
      double sum = 0.0;
      for (int y = row * side; y < (row + 1) * side; ++y) {
        for (int x = column * side; x < (column + 1) * side; ++x) {
          const float level = reduced.at(x, y);
          sum += level < level_max_ ? level : kNone;
        }
      }
      blocks.at(column, row) = valid ? static_cast<float>(sum / (side * side)) : kNone;
    }
  }
  Image<float> patches(std::max(0, blocks.width() - kPatchBlocks + 1), std::max(0, blocks.height() - kPatchBlocks + 1));
  for (int row = 0; row < patches.height(); ++row) {
    for (int column = 0; column < patches.width(); ++column) {
      float sum = 0.0F;
      for (int j = 0; j < kPatchBlocks; ++j) {
        for (int i = 0; i < kPatchBlocks; ++i) sum += blocks.at(column + i, row + j);
      }
      const float level = sum / (kPatchBlocks * kPatchBlocks);
      patches.at(column, row) = level > kDarkPart * level_max_ ? level : kNone;
    }
  }
  return patches;
}

Eigen::Vector2d VignettingFinder::PixelOfPatch(int column, int row) const {
  return block_px_.cwiseProduct(Eigen::Vector2d(column + 0.5 * kPatchBlocks, row + 0.5 * kPatchBlocks)) - Eigen::Vector2d::Constant(0.5);
}

double VignettingFinder::RadiusSquared(const Eigen::Vector2d& u) const {
  const Eigen::Vector2d half = 0.5 * (size_px_ - Eigen::Vector2d::Ones());
  return (u - half).squaredNorm() / half.squaredNorm();
}

void VignettingFinder::Add(const Image<float>& reduced, const std::optional<Affine>& previous_from_current) {
  if (!previous_from_current) keys_.clear();
  for (Key& key : keys_) key.key_from_current = key.key_from_current * *previous_from_current;
  const Eigen::Vector2d centre = 0.5 * (size_px_ - Eigen::Vector2d::Ones());
  const bool moved = keys_.empty() || (keys_.back().key_from_current * centre - centre).norm() >= kKeyPart * size_px_.minCoeff();
  if (!moved) return;
  const int side = std::max(1, std::min(reduced.width(), reduced.height()) / kBlocks);
  block_px_ = side * size_px_.cwiseQuotient(Eigen::Vector2d(reduced.width(), reduced.height()));
  Key current{PatchesOf(reduced), Affine()};
  if (key_count_ % group_stride_ == 0) {
    for (const Key& key : keys_) {
      if (std::optional<Pair> pair = Compare(current.patches, key)) pairs_.push_back(std::move(*pair));
    }
  }
  ++key_count_;
  if (key_count_ / group_stride_ > kGroupsMax) {
    group_stride_ *= 2;
    std::erase_if(pairs_, [this](const Pair& pair) { return pair.group % group_stride_ != 0; });
  }
  keys_.push_back(std::move(current));
  if (keys_.size() > kLags) keys_.pop_front();
}

std::optional<VignettingFinder::Pair> VignettingFinder::Compare(const Image<float>& current, const Key& key) const {
  Pair pair;
  pair.group = key_count_;
  std::vector<double> levels;
  double inverse_sum = 0.0;
  for (int row = 0; row < current.height(); row += kPatchBlocks) {
    for (int column = 0; column < current.width(); column += kPatchBlocks) {
      const Eigen::Vector2d u = PixelOfPatch(column, row), u_in_key = key.key_from_current * u;
      const Eigen::Vector2d node = (u_in_key - PixelOfPatch(0, 0)).cwiseQuotient(block_px_);
      if (!(node.x() >= 0.0 && node.y() >= 0.0 && node.x() < key.patches.width() - 1.0 && node.y() < key.patches.height() - 1.0)) continue;
      const int x = static_cast<int>(node.x()), y = static_cast<int>(node.y());
      const double a = node.x() - x, b = node.y() - y;
      const double before = (1.0 - b) * ((1.0 - a) * key.patches.at(x, y) + a * key.patches.at(x + 1, y)) +
                            b * ((1.0 - a) * key.patches.at(x, y + 1) + a * key.patches.at(x + 1, y + 1));
      const double now = current.at(column, row);
      if (!(before > 0.0) || !(now > 0.0)) continue;
      const double r2 = RadiusSquared(u), r2_in_key = RadiusSquared(u_in_key);
      pair.places.push_back({static_cast<float>(std::log(now / before)), static_cast<float>(2.0 / (now + before)),
                             static_cast<float>(r2 - r2_in_key), static_cast<float>(r2 * r2 - r2_in_key * r2_in_key)});
      inverse_sum += pair.places.back().inverse_level;
    }
  }
  if (pair.places.size() < kPlacesMin) return std::nullopt;
  const auto mean = static_cast<float>(inverse_sum / static_cast<double>(pair.places.size()));
  for (Observation& place : pair.places) place.inverse_level = place.inverse_level / mean - 1.0F;
  return pair;
}

// Weighted least squares over all pairs, gain and offset of each eliminated.
class VignettingFinder::Fit {
 public:
  explicit Fit(const std::vector<Pair>& pairs) : pairs_(pairs) {
    for (const Pair& pair : pairs) weights_.emplace_back(pair.places.size(), 1.0);
  }

  // False: not determined.
  bool Solve() {
    for (int round = 0; round < kRounds; ++round) {
      normal_ = Eigen::Matrix2d::Identity() / (kPriorSigma * kPriorSigma) * sigma2_;
      Eigen::Vector2d right = Eigen::Vector2d::Zero();
      for (std::size_t p = 0; p < pairs_.size(); ++p) {
        const Reduced reduced = Reduce(p);
        normal_ += reduced.normal;
        right += reduced.right;
      }
      shape_ = normal_.ldlt().solve(right);
      if (!shape_.allFinite()) return false;
      Reweigh();
    }
    return true;
  }

  Eigen::Vector2d shape() const { return shape_; }

  // Covariance with the groups of pairs as clusters.
  Eigen::Matrix2d Covariance() const {
    Eigen::Matrix2d meat = Eigen::Matrix2d::Zero();
    Eigen::Vector2d score = Eigen::Vector2d::Zero();
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      const Reduced reduced = Reduce(p);
      score += reduced.right - reduced.normal * shape_;
      if (p + 1 < pairs_.size() && pairs_[p + 1].group == pairs_[p].group) continue;
      meat += score * score.transpose();
      score.setZero();
    }
    const Eigen::Matrix2d inverse = normal_.inverse();
    return inverse * meat * inverse;
  }

 private:
  struct Reduced {
    Eigen::Matrix2d normal;
    Eigen::Vector2d right;
    Eigen::Vector2d nuisance;        // Gain and offset at shape 0.
    Eigen::Matrix2d nuisance_slope;  // And by how much a shape changes them.
  };

  Reduced Reduce(std::size_t p) const {
    Eigen::Matrix2d nn = Eigen::Matrix2d::Identity() * 1e-6, ns = Eigen::Matrix2d::Zero(), ss = Eigen::Matrix2d::Zero();
    Eigen::Vector2d ny = Eigen::Vector2d::Zero(), sy = Eigen::Vector2d::Zero();
    for (std::size_t i = 0; i < pairs_[p].places.size(); ++i) {
      const Observation& place = pairs_[p].places[i];
      const double w = weights_[p][i];
      const Eigen::Vector2d n(1.0, place.inverse_level), s(place.second, place.fourth);
      nn += w * n * n.transpose();
      ns += w * n * s.transpose();
      ss += w * s * s.transpose();
      ny += w * place.log_ratio * n;
      sy += w * place.log_ratio * s;
    }
    const Eigen::Matrix2d inverse = nn.inverse();
    return {ss - ns.transpose() * inverse * ns, sy - ns.transpose() * inverse * ny, inverse * ny, inverse * ns};
  }

  void Reweigh() {
    std::vector<std::vector<double>> residuals;
    std::vector<double> sizes;
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      const Reduced reduced = Reduce(p);
      const Eigen::Vector2d nuisance = reduced.nuisance - reduced.nuisance_slope * shape_;
      residuals.emplace_back();
      for (const Observation& place : pairs_[p].places) {
        const double fitted = nuisance.x() + nuisance.y() * place.inverse_level + shape_.x() * place.second + shape_.y() * place.fourth;
        residuals.back().push_back(place.log_ratio - fitted);
        sizes.push_back(std::abs(residuals.back().back()));
      }
    }
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    const double sigma = std::max(1e-5, 1.4826 * *middle);
    sigma2_ = sigma * sigma;
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      for (std::size_t i = 0; i < residuals[p].size(); ++i) {
        const double t = residuals[p][i] / (kTukey * sigma);
        weights_[p][i] = std::abs(t) < 1.0 ? (1.0 - t * t) * (1.0 - t * t) : 0.0;
      }
    }
  }

  const std::vector<Pair>& pairs_;
  std::vector<std::vector<double>> weights_;
  Eigen::Matrix2d normal_ = Eigen::Matrix2d::Identity();
  Eigen::Vector2d shape_ = Eigen::Vector2d::Zero();
  double sigma2_ = 0.05 * 0.05;
};

std::optional<VignettingEstimate> VignettingFinder::Find() const {
  std::set<std::size_t> groups;
  for (const Pair& pair : pairs_) groups.insert(pair.group);
  if (groups.size() < kGroupsMin) return std::nullopt;
  Fit fit(pairs_);
  if (!fit.Solve()) return std::nullopt;
  VignettingEstimate estimate;
  estimate.vignetting = {fit.shape().x(), fit.shape().y()};
  estimate.corner_error = kErrorFactor * std::sqrt(std::max(0.0, fit.Covariance().sum()));
  estimate.pair_count = pairs_.size();
  return estimate;
}

RadialVignetting FromProto(const v1::VignettingMessage& message) { return {message.second(), message.fourth()}; }

Image<float> BrighteningOf(const v1::SensorManifest& sensor, int width_px, int height_px) {
  if (!sensor.has_vignetting()) return {};
  const RadialVignetting vignetting = FromProto(sensor.vignetting());
  const Eigen::Vector2d half(0.5 * (width_px - 1), 0.5 * (height_px - 1));
  Image<float> brightening(width_px, height_px);
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x)
      brightening.at(x, y) = static_cast<float>(1.0 / vignetting.At((Eigen::Vector2d(x, y) - half).squaredNorm() / half.squaredNorm()));
  }
  return brightening;
}

void Brighten(const Image<float>& brightening, Image<float>* frame) {
  if (brightening.empty()) return;
  TREM_CHECK(brightening.width() == frame->width() && brightening.height() == frame->height());
  for (std::size_t i = 0; i < frame->pixels().size(); ++i) frame->pixels()[i] *= brightening.pixels()[i];
}

}  // namespace trem
