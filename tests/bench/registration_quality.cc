// Question: how near to the Cramer-Rao bound does the engine register a frame to its own scene, is the reported covariance honest, and
// what does a registration take?
// Baseline: the bound for a frame against the true, noise-free scene (6 corner displacements, gain and offset unknown, white noise), and
// twice it: the scene's place is known no better than its first frame's noise allows, and that error is common to all that follow.
// Frames are rendered from the truth by a denser model than the engine's own (tests/support/rendered_sequence.h).
//
// usage: registration_quality [options]; see --help
#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "worker/tre/segment.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Settings {
  SequenceOptions sequence;
  EngineOptions engine;
  int width = 151;
  int height = 151;
  int settled = 30;  // Frames before errors are counted.
  int seeds = 1;
  double model_psf = 0.0;
  bool projective = false;
};

struct Found {
  std::vector<double> errors_px;
  std::vector<double> chi2;    // Of 6 (8) degrees of freedom.
  std::vector<double> own_px;  // Error relative to the mean error of the settled frames: without the common part.
  std::vector<double> ms;
  int lost = 0;
  double last_gain_gauge = 1.0;  // Estimated gain / true gain at the end.
};

double Quantile(std::vector<double> values, double part) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(part * static_cast<double>(values.size())))];
}

Roi RoiOf(const Settings& s) {
  const int x0 = (s.sequence.roi_px - s.width) / 2;
  const int y0 = (s.sequence.roi_px - s.height) / 2;
  return {x0, y0, x0 + s.width, y0 + s.height};
}

Image<float> Cropped(const Image<float>& image, const Roi& roi) {
  Image<float> out(roi.width(), roi.height());
  for (int y = 0; y < roi.height(); ++y) std::copy(image.row(roi.y0 + y) + roi.x0, image.row(roi.y0 + y) + roi.x1, out.row(y));
  return out;
}

// The Cramer-Rao bound of the corner displacements of frame `t`, px^2.
CornerMatrix Bound(const Settings& s, const RenderedSequence& sequence, std::size_t t) {
  SequenceOptions clean = s.sequence;
  clean.noise_sigma = 0.0;
  constexpr double kStep = 0.05;
  const auto render = [&](double dx, double dy) {
    Affine moved;
    moved.offset = {dx, dy};
    return testing::RenderFrame(sequence.truth, clean, sequence.truth_from_sensor[t] * moved, 1.0, 0.0, 0);
  };
  const Image<float> value = render(0.0, 0.0);
  const Image<float> left = render(-kStep, 0.0), right = render(kStep, 0.0), up = render(0.0, -kStep), down = render(0.0, kStep);
  const Roi roi = RoiOf(s);
  const ViewModel model = s.engine.view_model;
  const int n = ParameterCount(model);
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(n + 2, n + 2);
  Eigen::VectorXd j(n + 2);
  for (int v = roi.y0; v < roi.y1; ++v) {
    for (int u = roi.x0; u < roi.x1; ++u) {
      const Eigen::RowVector2d slope((right.at(u, v) - left.at(u, v)) / (2.0 * kStep), (down.at(u, v) - up.at(u, v)) / (2.0 * kStep));
      j << (slope * CornerJacobian(roi, Eigen::Vector2d(u, v), model)).transpose(), value.at(u, v), 1.0;
      information += j * j.transpose() / (s.sequence.noise_sigma * s.sequence.noise_sigma);
    }
  }
  const Eigen::MatrixXd covariance = information.inverse();
  return covariance.topLeftCorner(n, n);
}

// Quantiles of the largest corner's error when the corner displacements have covariance factor * bound.
std::pair<double, double> ErrorsOf(const CornerMatrix& bound, double factor, const Roi& roi) {
  const Eigen::MatrixXd root = Eigen::MatrixXd(factor * bound).llt().matrixL();
  Rng rng({99});
  std::vector<double> errors;
  for (int k = 0; k < 4000; ++k) {
    Eigen::VectorXd z(root.rows());
    for (Eigen::Index i = 0; i < z.size(); ++i) z(i) = rng.Normal();
    errors.push_back(LargestCornerMotion(PlanarMap{}, Displace(PlanarMap{}, roi, CornerVector(root * z)), roi));
  }
  return {Quantile(errors, 0.5), Quantile(errors, 0.95)};
}

void RunSequence(const Settings& s, const RenderedSequence& sequence, Found* found) {
  const Roi roi = RoiOf(s);
  const Segment::Emit drop = [](const SceneSnapshot&) { return Status{}; };
  Segment segment(roi, *MakePsf(s.engine.psf, s.engine.ratio), s.engine, 0);
  const double noise = s.sequence.noise_sigma;
  // The scene plane: cell = 3 * (sensor - roi corner) at the first frame.
  Affine first;
  first.linear *= s.engine.ratio;
  first.offset = -s.engine.ratio * Eigen::Vector2d(roi.x0, roi.y0);
  std::vector<CornerVector> settled;
  for (std::size_t t = 0; t < sequence.frames.size(); ++t) {
    FrameInput frame = sequence.frames[t];
    frame.pixels = Cropped(frame.pixels, roi);
    if (t == 0) {
      (void)segment.Begin(frame, noise);
      continue;
    }
    const auto start = std::chrono::steady_clock::now();
    const JudgedRegistration judged = segment.RegisterFrame(frame, noise);
    const double ms = 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (!judged.doubt.empty()) {
      ++found->lost;
      segment.SkipFrame(frame);
      continue;
    }
    (void)segment.AddFrame(frame, judged.registration, noise, drop);
    if (static_cast<int>(t) < s.settled) continue;
    const Affine expected = first * sequence.truth_from_sensor[0].Inverse() * sequence.truth_from_sensor[t];
    const PlanarMap& view = judged.registration.view.scene_from_sensor;
    found->errors_px.push_back(LargestCornerMotion(view, expected, roi));
    const CornerVector d = CornerDisplacement(view, expected, roi, s.engine.view_model);
    found->chi2.push_back(d.dot(judged.registration.corner_covariance.ldlt().solve(d)));
    found->ms.push_back(ms);
    found->last_gain_gauge = judged.registration.view.gain / (sequence.gains[t] / sequence.gains[0]);
    settled.push_back(d);
  }
  if (settled.empty()) return;
  CornerVector mean = CornerVector::Zero(settled[0].size());
  for (const CornerVector& d : settled) mean += d / static_cast<double>(settled.size());
  for (const CornerVector& d : settled) {
    found->own_px.push_back(LargestCornerMotion(PlanarMap{}, Displace(PlanarMap{}, roi, CornerVector(d - mean)), roi));
  }
}

int Run(Settings s) {
  s.sequence.roi_px = std::max(s.width, s.height);
  s.engine.psf.sigma_px = s.model_psf > 0.0 ? s.model_psf : s.sequence.psf_sigma_px;
  s.engine.psf.fill_factor = s.sequence.fill_factor;
  s.engine.noise_sigma = s.sequence.noise_sigma;
  s.engine.noise_known = true;
  if (s.projective) s.engine.view_model = ViewModel::kProjective;
  Found found;
  CornerMatrix bound;
  for (int k = 0; k < s.seeds; ++k) {
    const RenderedSequence sequence = testing::RenderSequence(s.sequence);
    if (k == 0) bound = Bound(s, sequence, sequence.frames.size() / 2);
    RunSequence(s, sequence, &found);
    ++s.sequence.seed;
  }
  const Roi roi = RoiOf(s);
  const auto [own_median, own_p95] = ErrorsOf(bound, 1.0, roi);
  const auto [both_median, both_p95] = ErrorsOf(bound, 2.0, roi);
  const double dof = ParameterCount(s.engine.view_model);
  const double limit = dof == 6.0 ? 12.592 : 15.507;  // 95 % of chi-square.
  double chi2 = 0.0;
  int covered = 0;
  for (const double x : found.chi2) {
    chi2 += x / static_cast<double>(found.chi2.size());
    covered += x <= limit ? 1 : 0;
  }
  const double median = Quantile(found.errors_px, 0.5);
  std::printf("%dx%d frames %zu lost %d: corner error median %.4f p95 %.4f max %.4f px; without the common part %.4f / %.4f\n", s.width,
              s.height, found.errors_px.size(), found.lost, median, Quantile(found.errors_px, 0.95), Quantile(found.errors_px, 1.0),
              Quantile(found.own_px, 0.5), Quantile(found.own_px, 0.95));
  std::printf("  bound %.4f / %.4f, twice it %.4f / %.4f; error / bound %.2f, / twice %.2f; without the common part / bound %.2f\n",
              own_median, own_p95, both_median, both_p95, median / own_median, median / both_median,
              Quantile(found.own_px, 0.5) / own_median);
  std::printf("  chi2/dof %.2f, 95 %% ellipsoid covers %.1f %%; gain gauge %.4f; registration median %.3f p95 %.3f ms\n", chi2 / dof,
              100.0 * covered / static_cast<double>(std::max<std::size_t>(found.chi2.size(), 1)), found.last_gain_gauge,
              Quantile(found.ms, 0.5), Quantile(found.ms, 0.95));
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Settings s;
  s.sequence.frame_count = 90;
  s.sequence.psf_sigma_px = 0.6;
  s.sequence.speed_px = 0.1;
  CLI::App app("Registration against the Cramer-Rao bound");
  app.add_option("--width", s.width, "Of the ROI, sensor pixels");
  app.add_option("--height", s.height, "Of the ROI, sensor pixels");
  app.add_option("--frames", s.sequence.frame_count, "Frames of a sequence");
  app.add_option("--settled", s.settled, "Frames before errors are counted");
  app.add_option("--seeds", s.seeds, "Sequences, each with other ground and noise");
  app.add_option("--seed", s.sequence.seed, "Of the first sequence");
  app.add_option("--speed", s.sequence.speed_px, "Motion a frame, sensor pixels");
  app.add_option("--noise", s.sequence.noise_sigma, "Grey levels");
  app.add_option("--psf", s.sequence.psf_sigma_px, "True Gaussian part of the PSF, sensor pixels");
  app.add_option("--model-psf", s.model_psf, "What the engine believes it is; 0: the truth");
  app.add_option("--motion-sigma", s.sequence.motion_sigma_px, "Error of the whole-image motion that the engine is told, px");
  app.add_option("--forgetting", s.engine.forgetting, "Per frame; 0: automatic");
  app.add_option("--iterations", s.engine.iterations, "Scene updates a frame; 0: automatic");
  app.add_option("--weight", s.engine.structure_weight, "Factor on the regularisation");
  app.add_flag("--projective", s.projective, "8-parameter views");
  CLI11_PARSE(app, argc, argv);
  return trem::Run(s);
}
