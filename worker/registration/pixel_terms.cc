#include "worker/registration/pixel_terms.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "worker/registration/reduce.h"

namespace trem {
namespace {

// Moments of the prediction are taken about this grey level, so that single precision suffices for their sums.
constexpr float kCentre = 128.0F;

// [level pixel, 1] from [full pixel, 1], for pixels that average blocks of `step`.
Eigen::Matrix3d LevelFromFull(double step) {
  Eigen::Matrix3d m = Eigen::Matrix3d::Identity();
  m(0, 0) = m(1, 1) = 1.0 / step;
  m(0, 2) = m(1, 2) = -0.5 * (step - 1.0) / step;
  return m;
}

std::size_t Padded(std::size_t n) { return (n + kPixelBlock - 1) / kPixelBlock * kPixelBlock; }

}  // namespace

PixelTerms::PixelTerms(const Observation& observation, const Reference& reference, int reductions, int terms_about) : roi_(observation.roi) {
  Image<float> frame = *observation.roi_pixels;
  Image<float> weights;
  if (observation.weights != nullptr) weights = *observation.weights;
  const Image<float>* prediction = reference.prediction;
  const Image<float>* seen = reference.seen;
  for (int l = 0; l < reductions; ++l) {
    frame = ReduceByTwo(frame);
    if (!weights.empty()) weights = ReduceByTwo(weights);
  }
  for (int l = 0; l < (reductions > 0 ? reductions + 1 : 0); ++l) {
    reduced_prediction_ = ReduceByTwo(*prediction);
    reduced_seen_ = ReduceByTwoMinimum(*seen);
    prediction = &reduced_prediction_;
    seen = &reduced_seen_;
  }
  grid_ = {prediction->row(0), seen->row(0), prediction->width(), prediction->height(), reference.seen_min};
  const double step = 1 << reductions;
  Eigen::Matrix3d origin = Eigen::Matrix3d::Identity();
  origin(0, 2) = -reference.x0;
  origin(1, 2) = -reference.y0;
  grid_from_scene_ = LevelFromFull(reductions > 0 ? 2.0 * step : 1.0) * origin;

  const double area = static_cast<double>(frame.width()) * frame.height();
  const int stride = terms_about > 0 ? std::max(1, static_cast<int>(std::floor(std::sqrt(area / terms_about)))) : 1;
  for (int v = (stride - 1) / 2; v < frame.height(); v += stride) {
    for (int u = (stride - 1) / 2; u < frame.width(); u += stride) {
      const float weight = weights.empty() ? 1.0F : weights.at(u, v);
      if (std::isnan(frame.at(u, v)) || !(weight > 0.0F)) continue;
      x_.push_back(static_cast<float>(u * step + 0.5 * (step - 1.0)));
      y_.push_back(static_cast<float>(v * step + 0.5 * (step - 1.0)));
      intensity_.push_back(frame.at(u, v));
      used_weight_.push_back(weight);
      term_of_place_.push_back(count_++);
      weight_ += weight;
    }
  }
  all_end_ = Padded(x_.size());
  for (std::vector<float>* places : {&x_, &y_, &intensity_, &used_weight_}) places->resize(all_end_, 0.0F);
  term_of_place_.resize(all_end_, -1);
  factor_.assign(all_end_, 1.0F);
  value_.resize(all_end_);
  trust_.resize(all_end_);
}

PixelTerms::Range PixelTerms::Append(std::span<const int> terms) {
  const std::size_t begin = x_.size();
  const std::size_t end = begin + Padded(terms.size());
  for (const int term : terms) {
    const auto place = static_cast<std::size_t>(term);
    for (std::vector<float>* places : {&x_, &y_, &intensity_, &used_weight_, &factor_}) places->push_back((*places)[place]);
    term_of_place_.push_back(term);
  }
  for (std::vector<float>* places : {&x_, &y_, &intensity_, &used_weight_, &factor_, &value_, &trust_}) places->resize(end, 0.0F);
  term_of_place_.resize(end, -1);
  return {begin, end};
}

PixelSpan PixelTerms::SpanOf(const Range& range) const {
  return {x_.data() + range.begin, y_.data() + range.begin, intensity_.data() + range.begin, used_weight_.data() + range.begin,
          range.end - range.begin};
}

void PixelTerms::Sample(const Range& range, const View& view) {
  Eigen::Matrix3d sensor_from_roi = Eigen::Matrix3d::Identity();
  sensor_from_roi(0, 2) = roi_.x0;
  sensor_from_roi(1, 2) = roi_.y0;
  Eigen::Matrix3d m = grid_from_scene_ * view.scene_from_sensor.ToHomography().matrix * sensor_from_roi;
  m /= m(2, 2);
  PixelMap map;
  for (int k = 0; k < 8; ++k) map.m[k] = static_cast<float>(m(k / 3, k % 3));
  map.projective = m(2, 0) != 0.0 || m(2, 1) != 0.0;
  SamplePixels(grid_, map, SpanOf(range), value_.data() + range.begin, trust_.data() + range.begin);
}

PixelMoments PixelTerms::Moments(const Range& range, double gain, double offset) const {
  PixelMoments m = SumMoments(SpanOf(range), value_.data() + range.begin, trust_.data() + range.begin, factor_.data() + range.begin,
                              static_cast<float>(gain), static_cast<float>(offset), kCentre);
  m.rp += kCentre * m.r;
  m.pp += kCentre * (2.0 * m.p + kCentre * m.s);
  m.p += kCentre * m.s;
  return m;
}

double PixelTerms::Cost(const Range& range, double gain, double offset, double sigma) const {
  const PixelCost cost = SumHuber(SpanOf(range), value_.data() + range.begin, trust_.data() + range.begin, static_cast<float>(gain),
                                  static_cast<float>(offset), static_cast<float>(sigma), static_cast<float>(kHuberSigmas));
  return cost.huber + kMissingCost * cost.missing;
}

void PixelTerms::FreezeRobustFactors(double gain, double offset, double sigma) {
  HuberFactors(SpanOf(All()), value_.data(), trust_.data(), static_cast<float>(gain), static_cast<float>(offset), static_cast<float>(sigma),
               static_cast<float>(kHuberSigmas), factor_.data());
  for (std::size_t place = all_end_; place < factor_.size(); ++place) {
    if (term_of_place_[place] >= 0) factor_[place] = factor_[static_cast<std::size_t>(term_of_place_[place])];
  }
}

GainOffsetPosterior FitGainOffset(const PixelMoments& m, const ViewPrior& prior, double sigma) {
  const double inverse_variance = 1.0 / (sigma * sigma);
  Eigen::Matrix2d information;
  information << m.pp, m.p, m.p, m.s;
  information *= inverse_variance;
  information(0, 0) += 1.0 / (prior.gain_sigma * prior.gain_sigma);
  information(1, 1) += 1.0 / (prior.offset_sigma * prior.offset_sigma);
  const Eigen::Vector2d b = inverse_variance * Eigen::Vector2d(m.rp, m.r);
  GainOffsetPosterior fit;
  fit.covariance = information.inverse();
  const Eigen::Vector2d step = fit.covariance * b;
  fit.gain = prior.mean.gain + step(0);
  fit.offset = prior.mean.offset + step(1);
  fit.log_marginal = -0.5 * (inverse_variance * m.rr - b.dot(step)) - 0.5 * std::log(information.determinant());
  return fit;
}

}  // namespace trem
