#include "worker/registration/normal_equations.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "mosaic/base/parallel.h"

namespace trem {
namespace {

// Rows that one thread takes at a time.
constexpr int kBandRows = 32;
constexpr int kPowersOfT = 5;
using Totals = std::array<std::array<double, kMomentCount>, kPowersOfT>;

// Factors that the basis functions of the normal equations consist of.
enum Factor { kGx, kGy, kP, kOne, kR };

// coefficient * factor * s^a * t^b.
struct Term {
  double coefficient = 0.0;
  Factor factor = kOne;
  int s = 0;
  int t = 0;
};

using Basis = std::array<Term, 2>;

// Sum over pixels of w * factor1 * factor2 * s^s * t^t.
double Sum(const Totals& totals, Factor f1, Factor f2, int s, int t) {
  if (f1 > f2) std::swap(f1, f2);
  static constexpr int kFirst[5][5] = {
      {kXX, kXY, kXP, kX1, kXR}, {0, kYY, kYP, kY1, kYR}, {0, 0, kPP, kP1, kPR}, {0, 0, 0, k11, k1R}, {0, 0, 0, 0, kRR}};
  return totals[static_cast<std::size_t>(t)][static_cast<std::size_t>(kFirst[f1][f2] + s)];
}

double Inner(const Totals& totals, const Basis& f, const Basis& g) {
  double sum = 0.0;
  for (const Term& a : f) {
    for (const Term& b : g) {
      if (a.coefficient != 0.0 && b.coefficient != 0.0)
        sum += a.coefficient * b.coefficient * Sum(totals, a.factor, b.factor, a.s + b.s, a.t + b.t);
    }
  }
  return sum;
}

// The basis functions: gx, gx s, gx t, gy, gy s, gy t, then for projective views e s, e t with e = w gx s + h gy t, then P and 1.
std::vector<Basis> BasisOf(ViewModel model, double width, double height) {
  std::vector<Basis> basis;
  for (const Factor g : {kGx, kGy}) {
    basis.push_back({Term{1.0, g, 0, 0}});
    basis.push_back({Term{1.0, g, 1, 0}});
    basis.push_back({Term{1.0, g, 0, 1}});
  }
  if (model == ViewModel::kProjective) {
    basis.push_back({Term{width, kGx, 2, 0}, Term{height, kGy, 1, 1}});
    basis.push_back({Term{width, kGx, 1, 1}, Term{height, kGy, 0, 2}});
  }
  basis.push_back({Term{1.0, kP, 0, 0}});
  basis.push_back({Term{1.0, kOne, 0, 0}});
  return basis;
}

// Coefficients of the basis functions from the parameters: the displacement field of a corner displacement d is
//
//   dx = ul.x + (ur.x - ul.x + g w) s + (ll.x - ul.x) t - w s (g s + h t),   g = -Y / h', h = -X / w
//   dy = ul.y + (ur.y - ul.y) s + (ll.y - ul.y + h h') t - h' t (g s + h t)
//
// with (X, Y) = ul - ur - ll + lr, w x h' the ROI's size; affine: g = h = 0.
ParameterMatrix BasisFromParameters(ViewModel model, double width, double height) {
  const int corners = ParameterCount(model);
  ParameterMatrix t = ParameterMatrix::Zero(corners + 2, corners + 2);
  for (int axis = 0; axis < 2; ++axis) {
    t(3 * axis, axis) = 1.0;
    t(3 * axis + 1, 2 + axis) = t(3 * axis + 2, 4 + axis) = 1.0;
    t(3 * axis + 1, axis) = t(3 * axis + 2, axis) = -1.0;
  }
  if (model == ViewModel::kProjective) {
    constexpr double kSigns[4] = {1.0, -1.0, -1.0, 1.0};
    for (int k = 0; k < 4; ++k) {
      const double g = -kSigns[k] / height;  // Of corner k's y.
      const double h = -kSigns[k] / width;   // Of its x.
      t(1, 2 * k + 1) += g * width;
      t(5, 2 * k) += h * height;
      t(6, 2 * k + 1) = -g;
      t(7, 2 * k) = -h;
    }
  }
  t(corners, corners) = t(corners + 1, corners + 1) = 1.0;
  return t;
}

// Describes rows of a level to the kernel.
class RowMaker {
 public:
  RowMaker(const RegistrationLevel& level, const Roi& roi, const Reference& reference, const View& view, ViewModel model, double huber)
      : level_(level), roi_(roi), reference_(reference), view_(view), map_(view.scene_from_sensor.ToHomography().matrix) {
    const int stride = level.pixel_stride;
    row_.pixel_step = stride;
    row_.count = (level.frame->width() - stride / 2 + stride - 1) / stride;
    row_.stride = level.prediction->width();
    row_.seen_min = reference.seen_min;
    row_.gain = static_cast<float>(view.gain);
    row_.offset = static_cast<float>(view.offset);
    row_.huber = static_cast<float>(huber);
    const double width = std::max(roi.width() - 1, 1);
    s_scale_ = 1.0 / width;
    row_.s0 = static_cast<float>(FullFromLevel(stride / 2, level.frame_step) * s_scale_);
    row_.s1 = static_cast<float>(stride * level.frame_step * s_scale_);
    projective_ = model == ViewModel::kProjective || !view.scene_from_sensor.IsAffine();
  }

  bool projective() const { return projective_; }

  const MomentRow& Row(int v) {
    const RegistrationLevel& l = level_;
    const int stride = l.pixel_stride;
    row_.pixels = l.frame->row(v) + stride / 2;
    row_.weights = l.weights != nullptr ? l.weights->row(v) + stride / 2 : nullptr;
    const double y = roi_.y0 + FullFromLevel(v, l.frame_step);
    const double x = roi_.x0 + FullFromLevel(stride / 2, l.frame_step);
    const Eigen::Vector3d start = map_ * Eigen::Vector3d(x, y, 1.0);
    const Eigen::Vector3d step = map_.col(0) * (stride * l.frame_step);
    // Level coordinates: (scene - reference origin - half a block) / step.
    const double shift = 0.5 * (l.reference_step - 1.0);
    const Eigen::Vector2d origin(reference_.x0 + shift, reference_.y0 + shift);
    const Eigen::Vector2d n0 = (start.head<2>() - origin * start.z()) / l.reference_step;
    const Eigen::Vector2d n1 = (step.head<2>() - origin * step.z()) / l.reference_step;
    // Relative to a cell near the middle of the row's track, inside the image.
    const Eigen::Vector2d middle = (n0 + n1 * (0.5 * row_.count)) / (start.z() + step.z() * (0.5 * row_.count));
    const auto inside = [](double at, int size) {
      return std::isfinite(at) ? std::clamp(static_cast<int>(std::clamp(at, -1e6, 1e6)), 1, size - 3) : 1;
    };
    const int bx = inside(middle.x(), l.prediction->width());
    const int by = inside(middle.y(), l.prediction->height());
    row_.prediction = l.prediction->row(by) + bx;
    row_.seen = l.seen->row(by) + bx;
    row_.nx0 = static_cast<float>(n0.x() - bx * start.z());
    row_.nx1 = static_cast<float>(n1.x() - bx * step.z());
    row_.ny0 = static_cast<float>(n0.y() - by * start.z());
    row_.ny1 = static_cast<float>(n1.y() - by * step.z());
    row_.d0 = static_cast<float>(start.z());
    row_.d1 = static_cast<float>(step.z());
    row_.x_min = static_cast<float>(1 - bx);
    row_.y_min = static_cast<float>(1 - by);
    row_.x_max = static_cast<float>(l.prediction->width() - 2 - bx);
    row_.y_max = static_cast<float>(l.prediction->height() - 2 - by);
    // d(level point) / d(sensor point) = (linear - point perspective') / (D step), the point in scene coordinates.
    const Eigen::Vector2d base = origin + Eigen::Vector2d(bx, by) * l.reference_step;
    const double scale = view_.gain / l.reference_step;
    const PlanarMap& m = view_.scene_from_sensor;
    row_.ax = static_cast<float>(scale * (m.linear(0, 0) - base.x() * m.perspective.x()));
    row_.ay = static_cast<float>(scale * (m.linear(1, 0) - base.y() * m.perspective.x()));
    row_.cx = static_cast<float>(scale * (m.linear(0, 1) - base.x() * m.perspective.y()));
    row_.cy = static_cast<float>(scale * (m.linear(1, 1) - base.y() * m.perspective.y()));
    row_.bx = static_cast<float>(view_.gain * m.perspective.x());
    row_.by = static_cast<float>(view_.gain * m.perspective.y());
    return row_;
  }

 private:
  const RegistrationLevel& level_;
  const Roi& roi_;
  const Reference& reference_;
  const View& view_;
  Eigen::Matrix3d map_;
  MomentRow row_;
  double s_scale_ = 1.0;
  bool projective_ = false;
};

void CountResiduals(const MomentScratch& scratch, int count, double sigma, ResidualHistogram* histogram) {
  const float scale = static_cast<float>(ResidualHistogram::kBinsPerSigma / sigma);
  for (int i = 0; i < count; ++i) {
    const float magnitude = scratch.residual[static_cast<std::size_t>(i)];
    if (magnitude < 0.0F) continue;
    ++histogram->total;
    const float bin = magnitude * scale;
    if (bin < static_cast<float>(ResidualHistogram::kBins)) ++histogram->counts[static_cast<std::size_t>(bin)];
  }
}

NormalEquations Assemble(const Totals& totals, const View& view, const Roi& roi, ViewModel model, double noise_sigma) {
  const double width = std::max(roi.width() - 1, 1);
  const double height = std::max(roi.height() - 1, 1);
  const double inverse_variance = 1.0 / (noise_sigma * noise_sigma);
  const std::vector<Basis> basis = BasisOf(model, width, height);
  const Basis residual = {Term{1.0, kR, 0, 0}};
  const auto n = static_cast<Eigen::Index>(basis.size());
  ParameterMatrix gram(n, n);
  Parameters right(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Basis& f = basis[static_cast<std::size_t>(i)];
    for (Eigen::Index k = i; k < n; ++k) gram(i, k) = gram(k, i) = inverse_variance * Inner(totals, f, basis[static_cast<std::size_t>(k)]);
    right(i) = inverse_variance * Inner(totals, f, residual);
  }
  const ParameterMatrix t = BasisFromParameters(model, width, height);
  NormalEquations normal;
  normal.a = t.transpose() * gram * t;
  normal.b = t.transpose() * right;
  // J of a corner is gain times the slope of P.
  const Eigen::Index corners = n - 2;
  normal.d_pp = 2.0 * normal.a.col(corners).head(corners) / (view.gain * inverse_variance);
  normal.d_p = normal.a.col(corners + 1).head(corners) / (view.gain * inverse_variance);
  const auto& m = totals[0];
  normal.seen_weight = m[kSeen];
  normal.robust_weight = m[k11];
  normal.sum_w_r2 = m[kRR];
  normal.sum_w_p = m[kP1];
  normal.sum_w_p2 = m[kPP];
  // I = gain P + offset + r.
  const double g = view.gain;
  const double o = view.offset;
  normal.sum_w_i = g * m[kP1] + o * m[k11] + m[k1R];
  normal.sum_w_i2 = g * g * m[kPP] + o * o * m[k11] + m[kRR] + 2.0 * (g * o * m[kP1] + g * m[kPR] + o * m[k1R]);
  normal.pixels = std::llround(m[kCount]);
  return normal;
}

}  // namespace

void ResidualHistogram::Add(const ResidualHistogram& other) {
  total += other.total;
  for (std::size_t bin = 0; bin < counts.size(); ++bin) counts[bin] += other.counts[bin];
}

double ResidualHistogram::Median() const {
  if (total == 0) return 0.0;
  const double half = 0.5 * static_cast<double>(total);
  double below = 0.0;
  for (int bin = 0; bin < kBins; ++bin) {
    const double count = counts[static_cast<std::size_t>(bin)];
    if (below + count >= half) return (bin + (half - below) / count) / kBinsPerSigma;
    below += count;
  }
  return kBins / kBinsPerSigma;
}

NormalEquations AccumulateNormal(const RegistrationLevel& level, const Roi& roi, const Reference& reference, const View& view,
                                 ViewModel model, double noise_sigma, double huber_sigmas, ResidualHistogram* histogram) {
  Totals totals{};
  long long candidates = 0;
  const bool usable = level.prediction->width() >= 4 && level.prediction->height() >= 4;
  if (usable && std::isfinite(view.gain) && std::isfinite(view.offset)) {
    const int stride = level.pixel_stride;
    const int rows = std::max(level.frame->height() - stride / 2 + stride - 1, 0) / stride;
    const auto row_of = [stride](int index) { return stride / 2 + index * stride; };
    const int bands = (rows + kBandRows - 1) / kBandRows;
    std::vector<float> moments(static_cast<std::size_t>(rows) * kMomentCount);
    std::vector<ResidualHistogram> histograms(histogram != nullptr ? static_cast<std::size_t>(std::max(level.threads, 1)) : 0);
    std::vector<long long> counts(static_cast<std::size_t>(rows), 0);
    ForEachIndex(level.threads, bands, [&](int band, int slot) {
      RowMaker maker(level, roi, reference, view, model, huber_sigmas * noise_sigma);
      MomentScratch scratch;
      for (int index = band * kBandRows; index < std::min((band + 1) * kBandRows, rows); ++index) {
        const MomentRow& row = maker.Row(row_of(index));
        RowMoments(row, maker.projective(), &scratch, moments.data() + static_cast<std::size_t>(index) * kMomentCount);
        counts[static_cast<std::size_t>(index)] = row.count;
        if (histogram != nullptr && index % 2 == 0) {
          CountResiduals(scratch, row.count, noise_sigma, &histograms[static_cast<std::size_t>(slot)]);
        }
      }
    });
    // Rows are added in their order, whoever has made them; counts have no order.
    const double height = std::max(roi.height() - 1, 1);
    for (int index = 0; index < rows; ++index) {
      const float* row = moments.data() + static_cast<std::size_t>(index) * kMomentCount;
      candidates += counts[static_cast<std::size_t>(index)];
      const double t = FullFromLevel(row_of(index), level.frame_step) / height;
      double power = 1.0;
      for (int k = 0; k < (model == ViewModel::kProjective ? 5 : 3); ++k, power *= t) {
        auto& total = totals[static_cast<std::size_t>(k)];
        for (std::size_t m = 0; m < kMomentCount; ++m) total[m] += power * static_cast<double>(row[m]);
      }
    }
    for (const ResidualHistogram& part : histograms) histogram->Add(part);
  }
  NormalEquations normal = Assemble(totals, view, roi, model, noise_sigma);
  normal.candidates = candidates;
  return normal;
}

}  // namespace trem
