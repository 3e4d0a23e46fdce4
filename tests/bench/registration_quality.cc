// Question: how near to the Cramer-Rao bound does the engine register a frame to its own scene, is the reported covariance honest, and
// what does a registration take?
// Errors are those of the worst of the ROI's four corners, in two definitions:
//
//   relative   after the one affine map of the scene plane that fits all settled views best: how well the frames fit each other, which is
//              all that a registration decides. Where the plane lies is a gauge (telemetry ties it to the ground later).
//   absolute   on the plane that the first frame's true view defines. The scene lies where the first frame's noise put it, an error as
//              large as a frame's own that all views share and that no method can reduce.
//
// Baseline: the bound for a frame against the true, noise-free scene (6 corner displacements, gain and offset unknown, white noise), and
// of twice that variance for the absolute error. Frames are rendered from the truth by a denser model than the engine's own
// (tests/support/rendered_sequence.h).
//
// usage: registration_quality [TRUTH_IMAGE] [options]; see --help
#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/truth_picture.h"
#include "worker/simulate/truth.h"
#include "worker/tre/segment.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Settings {
  SequenceOptions sequence;
  EngineOptions engine;
  std::string truth;                     // Picture; empty: procedural terrain.
  std::vector<int> place = {1250, 400};  // Upper left pixel of the part of it that is used.
  int width = 151;
  int height = 151;
  int settled = 30;  // Frames before errors are counted.
  int seeds = 3;
  double model_psf = 0.0;
  bool projective = false;
};

struct Found {
  std::vector<double> absolute_px;
  std::vector<double> relative_px;
  std::vector<double> bound_px;          // Draws of the largest corner's error from the sequences' bounds.
  std::vector<double> twice_px;          // The same from twice the bounds.
  std::vector<double> relative_medians;  // One a sequence.
  std::vector<double> relative_p95s;
  std::vector<double> chi2;  // Of 6 (8) degrees of freedom.
  std::vector<double> ms;
  int lost = 0;
  double worst_gain_gauge = 0.0;  // |estimated gain / true gain - 1| at a sequence's end.
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

// Draws of the largest corner's error when the corner displacements have covariance factor * bound.
void DrawErrors(const CornerMatrix& bound, double factor, const Roi& roi, std::vector<double>* errors) {
  const Eigen::MatrixXd root = Eigen::MatrixXd(factor * bound).llt().matrixL();
  Rng rng({99});
  for (int k = 0; k < 1000; ++k) {
    Eigen::VectorXd z(root.rows());
    for (Eigen::Index i = 0; i < z.size(); ++i) z(i) = rng.Normal();
    errors->push_back(LargestCornerMotion(PlanarMap{}, Displace(PlanarMap{}, roi, CornerVector(root * z)), roi));
  }
}

// A settled frame: where it was found and where it truly was, on the scene plane.
struct Settled {
  PlanarMap found;
  Affine truth;
};

// The affine map of the scene plane that takes the true places of the frames' corners nearest to those found.
Affine BestCommonMap(const std::vector<Settled>& frames, const Roi& roi) {
  Eigen::MatrixX3d from(static_cast<Eigen::Index>(4 * frames.size()), 3);
  Eigen::MatrixX2d to(from.rows(), 2);
  Eigen::Index row = 0;
  for (const Settled& frame : frames) {
    for (const int x : {roi.x0, roi.x1 - 1}) {
      for (const int y : {roi.y0, roi.y1 - 1}) {
        from.row(row) << (frame.truth * Eigen::Vector2d(x, y)).transpose(), 1.0;
        to.row(row++) = (frame.found * Eigen::Vector2d(x, y)).transpose();
      }
    }
  }
  const Eigen::Matrix<double, 3, 2> fit = from.colPivHouseholderQr().solve(to);
  Affine map;
  map.linear = fit.topRows<2>().transpose();
  map.offset = fit.row(2).transpose();
  return map;
}

void RunSequence(const Settings& s, const RenderedSequence& sequence, Found* found) {
  const Roi roi = RoiOf(s);
  const Segment::Emit drop = [](const SceneSnapshot&) { return Status{}; };
  Segment segment(roi, *MakePsf(s.engine.psf, s.engine.ratio), s.engine, 0);
  const double noise = s.sequence.noise_sigma;
  double gain_gauge = 1.0;
  // The scene plane: cell = 3 * (sensor - roi corner) at the first frame.
  Affine first;
  first.linear *= s.engine.ratio;
  first.offset = -s.engine.ratio * Eigen::Vector2d(roi.x0, roi.y0);
  std::vector<Settled> settled;
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
    found->absolute_px.push_back(LargestCornerMotion(view, expected, roi));
    const CornerVector d = CornerDisplacement(view, expected, roi, s.engine.view_model);
    found->chi2.push_back(d.dot(judged.registration.corner_covariance.ldlt().solve(d)));
    found->ms.push_back(ms);
    gain_gauge = judged.registration.view.gain / (sequence.gains[t] / sequence.gains[0]);
    settled.push_back({view, expected});
  }
  found->worst_gain_gauge = std::max(found->worst_gain_gauge, std::abs(gain_gauge - 1.0));
  if (settled.empty()) return;
  const Affine common = BestCommonMap(settled, roi);
  std::vector<double> relative;
  for (const Settled& frame : settled) relative.push_back(LargestCornerMotion(frame.found, PlanarMap(common * frame.truth), roi));
  found->relative_medians.push_back(Quantile(relative, 0.5));
  found->relative_p95s.push_back(Quantile(relative, 0.95));
  found->relative_px.insert(found->relative_px.end(), relative.begin(), relative.end());
  const CornerMatrix bound = Bound(s, sequence, sequence.frames.size() / 2);
  DrawErrors(bound, 1.0, roi, &found->bound_px);
  DrawErrors(bound, 2.0, roi, &found->twice_px);
}

double Sd(const std::vector<double>& values) {
  double mean = 0.0;
  for (const double x : values) mean += x / static_cast<double>(values.size());
  double sum = 0.0;
  for (const double x : values) sum += (x - mean) * (x - mean);
  return values.size() > 1 ? std::sqrt(sum / static_cast<double>(values.size() - 1)) : 0.0;
}

int Run(Settings s) {
  s.sequence.roi_px = std::max(s.width, s.height);
  s.engine.psf.sigma_px = s.model_psf > 0.0 ? s.model_psf : s.sequence.psf_sigma_px;
  s.engine.psf.fill_factor = s.sequence.fill_factor;
  s.engine.noise_sigma = s.sequence.noise_sigma;
  s.engine.noise_known = true;
  if (s.projective) s.engine.view_model = ViewModel::kProjective;
  const int width = testing::TruthWidth(s.sequence);
  const int height = testing::TruthHeight(s.sequence);
  Found found;
  for (int k = 0; k < s.seeds; ++k) {
    Image<float> truth = s.truth.empty() ? ProceduralTerrain(width, height, s.sequence.seed, 0)
                                         : testing::ReadTruthPicture(s.truth, s.place[0], s.place[1], width, height);
    if (truth.empty()) return 3;
    RunSequence(s, testing::RenderSequence(std::move(truth), s.sequence), &found);
    ++s.sequence.seed;
  }
  const double dof = ParameterCount(s.engine.view_model);
  const double limit = dof == 6.0 ? 12.592 : 15.507;  // 95 % of chi-square.
  double chi2 = 0.0;
  int covered = 0;
  for (const double x : found.chi2) {
    chi2 += x / static_cast<double>(found.chi2.size());
    covered += x <= limit ? 1 : 0;
  }
  std::printf("%dx%d px, %s, %d sequences, %zu settled frames, lost %d; corner error median / p95, px\n", s.width, s.height,
              s.truth.empty() ? "procedural" : s.truth.c_str(), s.seeds, found.absolute_px.size(), found.lost);
  const auto print = [](const char* name, const std::vector<double>& errors, const std::vector<double>& bound) {
    std::printf("  %-28s %.4f / %.4f, worst %.4f; bound %.4f / %.4f; error / bound %.2f / %.2f\n", name, Quantile(errors, 0.5),
                Quantile(errors, 0.95), Quantile(errors, 1.0), Quantile(bound, 0.5), Quantile(bound, 0.95),
                Quantile(errors, 0.5) / Quantile(bound, 0.5), Quantile(errors, 0.95) / Quantile(bound, 0.95));
  };
  print("relative", found.relative_px, found.bound_px);
  std::printf("  %-28s %.4f / %.4f\n", "  sd over sequences", Sd(found.relative_medians), Sd(found.relative_p95s));
  print("absolute", found.absolute_px, found.twice_px);
  std::printf(
      "  absolute: chi2/dof %.2f, the 95 %% ellipsoid covers %.1f %%; gain gauge within %.4f; registration median %.3f p95 %.3f ms\n",
      chi2 / dof, 100.0 * covered / static_cast<double>(std::max<std::size_t>(found.chi2.size(), 1)), found.worst_gain_gauge,
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
  app.add_option("truth", s.truth, "Picture to look at; default: procedural terrain");
  app.add_option("--place", s.place, "Upper left pixel of the part of the picture: x,y")->delimiter(',')->expected(2);
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
