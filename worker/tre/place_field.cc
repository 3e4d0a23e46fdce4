#include "worker/tre/place_field.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace trem {
namespace {

constexpr int kBlocksPerSide = 4;
// Samples that a side of the ROI is looked at with, about.
constexpr int kSamplesPerSide = 32;
// Standard deviation [sensor px] of what is known of a view beforehand: for ROIs without texture.
constexpr double kPriorSigmaPx = 0.7;
// Calibrated against independently rendered frames (tests/unit/worker/tre/segment_coverage_test.cc). A frame's noise in ground that is not
// all equally old: ground that comes in within one block is of many ages, and the youngest weighs most.
constexpr double kAgeFactor = 2.2;
// What is off in a sample beside its noise, as a place [cells] of its contrast: one frame aliases. The first frames, which are registered
// again when eight have been seen, and those that bring new ground.
constexpr double kFirstPlaceSigma = 0.07;
constexpr double kPlaceSigma = 0.15;

// Of what an int holds.
int Floor(double x) {
  const int whole = static_cast<int>(x);
  return x < whole ? whole - 1 : whole;
}

}  // namespace

PlaceField::PlaceField(const Roi& roi, int ratio, ViewModel model)
    : model_(model),
      block_width_(static_cast<double>(ratio) * roi.width() / kBlocksPerSide),
      block_height_(static_cast<double>(ratio) * roi.height() / kBlocksPerSide),
      stride_(std::max(1, std::min(roi.width(), roi.height()) / kSamplesPerSide)) {}

PlaceField::Texture PlaceField::Measure(const Observation& observation, const Reference& reference, const View& view) const {
  const Image<float>& prediction = *reference.prediction;
  const Roi& roi = observation.roi;
  const PlanarMap& map = view.scene_from_sensor;
  const double per_sample = static_cast<double>(stride_) * stride_;
  const double scale = view.gain * view.gain / (observation.noise_sigma * observation.noise_sigma);
  const double blocks_x = 1.0 / block_width_;
  const double blocks_y = 1.0 / block_height_;
  Texture texture;
  const auto block_at = [&texture](int x, int y) -> BlockTexture& {
    // Successive pixels mostly lie in one block.
    for (auto block = texture.rbegin(); block != texture.rend(); ++block) {
      if (block->x == x && block->y == y) return *block;
    }
    texture.push_back({x, y});
    return texture.back();
  };
  for (int v = stride_ / 2; v < roi.height(); v += stride_) {
    const Eigen::Vector2d first(roi.x0, roi.y0 + v);
    const Eigen::Vector2d start = map.linear * first + map.offset;
    const double depth = map.Depth(first);
    for (int u = stride_ / 2; u < roi.width(); u += stride_) {
      const double weight = std::isnan(observation.roi_pixels->at(u, v)) ? 0.0 : static_cast<double>(observation.weight(u, v));
      if (!(weight > 0.0)) continue;
      const double inverse = 1.0 / (depth + u * map.perspective.x());
      const double cell_x = (start.x() + u * map.linear(0, 0)) * inverse;
      const double cell_y = (start.y() + u * map.linear(1, 0)) * inverse;
      const double column = cell_x - reference.x0 + 0.5;
      const double row = cell_y - reference.y0 + 0.5;
      if (!(column >= 1.0 && row >= 1.0 && column < prediction.width() - 1.0 && row < prediction.height() - 1.0)) continue;
      const int x = static_cast<int>(column);
      const int y = static_cast<int>(row);
      BlockTexture& block = block_at(Floor(cell_x * blocks_x), Floor(cell_y * blocks_y));
      const float* const centre = prediction.row(y) + x;
      const double slope_x = 0.5F * (centre[1] - centre[-1]);
      const double slope_y = 0.5F * (centre[prediction.width()] - centre[-prediction.width()]);
      const double pixels = per_sample * weight;
      block.pixels += pixels;
      Eigen::Matrix2d information;
      information << slope_x * slope_x, slope_x * slope_y, slope_x * slope_y, slope_y * slope_y;
      information *= pixels * scale;
      block.information += information;
      block.contrast += scale * (slope_x * slope_x + slope_y * slope_y) * information;
      block.centre += pixels * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double seen = reference.seen->at(x, y);
      if (seen >= reference.seen_min && seen > 0.0) block.registered += pixels * seen / (seen + 1.0);
    }
  }
  for (BlockTexture& block : texture) {
    block.information /= block.pixels;
    block.contrast /= block.pixels;
    block.centre /= block.pixels;
  }
  return texture;
}

Eigen::Index PlaceField::Find(int x, int y) const {
  for (std::size_t b = 0; b < blocks_.size(); ++b) {
    if (blocks_[b].x == x && blocks_[b].y == y) return static_cast<Eigen::Index>(b);
  }
  return -1;
}

Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 8> PlaceField::Motion(const BlockTexture& block, const Roi& roi, const View& view) const {
  return view.scene_from_sensor.LinearisedAt(block.centre).linear * CornerJacobian(roi, block.centre, model_);
}

PlaceField::Fit PlaceField::FitOf(const Texture& texture, const Observation& observation, const View& view) const {
  const Eigen::Index n = ParameterCount(model_);
  CornerMatrix information = CornerMatrix::Identity(n, n) / (kPriorSigmaPx * kPriorSigmaPx);
  Matrix right = Matrix::Zero(n, covariance_.cols());
  for (const BlockTexture& block : texture) {
    const Eigen::Index b = Find(block.x, block.y);
    if (b < 0 || block.registered == 0.0) continue;
    const auto motion = Motion(block, observation.roi, view);
    information += block.registered * motion.transpose() * blocks_[static_cast<std::size_t>(b)].information * motion;
    right.middleCols<2>(2 * b) += block.registered * motion.transpose();
  }
  Fit fit;
  fit.inverse = information.inverse();
  fit.gain = fit.inverse * right;
  return fit;
}

CornerMatrix PlaceField::CovarianceOf(const Texture& texture, const Observation& observation, const View& view) const {
  const Fit fit = FitOf(texture, observation, view);
  return fit.gain * covariance_ * fit.gain.transpose();
}

void PlaceField::Add(const Texture& before, const Texture& after, const Observation& observation, const View& view, double forgetting) {
  const bool first = blocks_.empty();
  const Eigen::Index n = ParameterCount(model_);
  for (const BlockTexture& block : after) {
    if (Find(block.x, block.y) < 0) blocks_.push_back({block.x, block.y, 0.0, block.information});
  }
  const auto size = static_cast<Eigen::Index>(2 * blocks_.size());
  const Eigen::Index old = covariance_.rows();
  covariance_.conservativeResizeLike(Matrix::Zero(size, size));
  covariance_.rightCols(size - old).setZero();
  covariance_.bottomRows(size - old).setZero();

  const Fit fit = first ? Fit{CornerMatrix::Zero(n, n), Matrix::Zero(n, size)} : FitOf(before, observation, view);
  // y <- keep y + moved (fit.gain y - d_s) + s / n.
  Eigen::VectorXd keep = Eigen::VectorXd::Ones(size);
  Matrix moved = Matrix::Zero(size, n);
  Matrix cross = Matrix::Zero(size, n);  // Covariance of s / n with d_s.
  Matrix own = Matrix::Zero(n, n);       // Covariance of d_s.
  std::vector<std::pair<Eigen::Index, Eigen::Matrix2d>> scores;
  for (const BlockTexture& texture : after) {
    const Eigen::Index b = Find(texture.x, texture.y);
    Block& block = blocks_[static_cast<std::size_t>(b)];
    const double total = forgetting * block.pixels + texture.pixels;
    keep.segment<2>(2 * b).setConstant(forgetting * block.pixels / total);
    const double part = texture.pixels / total;
    const double noise = first ? 1.0 : kAgeFactor;
    const double place = first ? kFirstPlaceSigma : kPlaceSigma;
    const Eigen::Matrix2d variance = noise * texture.information + place * place * texture.contrast;
    block.information += part * (texture.information - block.information);
    block.pixels = total;
    const auto motion = Motion(texture, observation.roi, view);
    moved.middleRows<2>(2 * b) = part * texture.information * motion;
    scores.emplace_back(b, part / total * variance);
    const auto in_fit =
        std::find_if(before.begin(), before.end(), [&](const BlockTexture& t) { return t.x == texture.x && t.y == texture.y; });
    if (first || in_fit == before.end() || in_fit->registered == 0.0) continue;
    const double share = std::min(in_fit->registered / texture.pixels, 1.0);
    const Eigen::Matrix<double, Eigen::Dynamic, 2, 0, 8, 2> weight = share * fit.inverse * motion.transpose();  // d_s from s_b.
    cross.middleRows<2>(2 * b) = part * variance * weight.transpose();
    own += texture.pixels * weight * variance * weight.transpose();
  }
  const Matrix from_gain = fit.gain * covariance_;
  const Matrix kept = moved * (from_gain * keep.asDiagonal());
  Matrix next = keep.asDiagonal() * covariance_ * keep.asDiagonal();
  const Matrix noise = moved * cross.transpose();
  next += kept + kept.transpose() + moved * (from_gain * fit.gain.transpose() + own) * moved.transpose() - noise - noise.transpose();
  for (const auto& [b, score] : scores) next.block<2, 2>(2 * b, 2 * b) += score;
  covariance_ = next;
}

void PlaceField::Keep(const Roi& extent) {
  std::vector<Eigen::Index> kept;
  std::vector<Block> blocks;
  for (std::size_t b = 0; b < blocks_.size(); ++b) {
    const Block& block = blocks_[b];
    if (block.x * block_width_ >= extent.x1 || (block.x + 1) * block_width_ <= extent.x0 || block.y * block_height_ >= extent.y1 ||
        (block.y + 1) * block_height_ <= extent.y0) {
      continue;
    }
    kept.push_back(static_cast<Eigen::Index>(2 * b));
    kept.push_back(static_cast<Eigen::Index>(2 * b + 1));
    blocks.push_back(block);
  }
  if (blocks.size() == blocks_.size()) return;
  covariance_ = Matrix(covariance_(kept, kept));
  blocks_ = std::move(blocks);
}

void PlaceField::Clear() {
  blocks_.clear();
  covariance_.resize(0, 0);
}

}  // namespace trem
