// Question: how much sharper than one bicubic frame is the engine's scene, how well does it register, and what does a frame cost?
// Baseline: the first frame enlarged bicubically, placed with its true view. Truth: the scene filtered by [1 2 1]/4 in each axis on the
// 3:1 grid, which is what such a grid can carry. Frames are rendered from the truth by a denser model than the engine's own (7 x 7
// samples over PSF and detector of every pixel) along a smooth path with rotation, zoom, gain and offset drift.
//
// usage: engine_quality [TRUTH_IMAGE] [--frames N] [--roi N] [--speed PX] [--noise SIGMA] [--psf SIGMA] [--seed N] [--weight W] [--forgetting F]
#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "mosaic/base/rng.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/mapping_engine.h"

namespace trem {
namespace {

struct Settings {
  std::string truth;
  int frames = 100;
  int roi = 151;
  double speed_px = 1.9;
  double noise = 2.0;
  double psf = 0.6;
  double model_psf = 0.0;
  std::uint64_t seed = 1;
  double weight = 1.0;
  double forgetting = 0.0;
  int iterations = 0;
  std::string method = "auto";
  std::string picture;
  int truth_x = 1000, truth_y = 300;
  bool exact_motion = false;
};

// Without a picture: smooth fields with roads, roofs and bars.
Image<float> ProceduralTruth(int width, int height, std::uint64_t seed) {
  cv::Mat canvas(height, width, CV_32F, cv::Scalar(110));
  Rng rng({seed, 77});
  for (int i = 0; i < width * height / 2500; ++i) {
    const cv::Point2f centre(static_cast<float>(rng.Uniform() * width), static_cast<float>(rng.Uniform() * height));
    const cv::RotatedRect rect(centre, cv::Size2f(static_cast<float>(6 + 60 * rng.Uniform()), static_cast<float>(3 + 30 * rng.Uniform())),
                               static_cast<float>(180 * rng.Uniform()));
    cv::Point2f corners[4];
    rect.points(corners);
    std::vector<cv::Point> polygon;
    for (const auto& c : corners) polygon.emplace_back(static_cast<int>(c.x * 16), static_cast<int>(c.y * 16));
    cv::fillConvexPoly(canvas, polygon, cv::Scalar(40 + 180 * rng.Uniform()), cv::LINE_AA, 4);
  }
  Image<float> truth(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) truth.at(x, y) = canvas.at<float>(y, x) + static_cast<float>(4.0 * rng.Normal());
  }
  return truth;
}

Image<float> FromMat(const cv::Mat& grey) {
  Image<float> image(grey.cols, grey.rows);
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) image.at(x, y) = grey.at<unsigned char>(y, x);
  }
  return image;
}

Image<float> Filtered121(const Image<float>& truth) {
  Image<float> out(truth.width(), truth.height());
  for (int y = 1; y + 1 < truth.height(); ++y) {
    for (int x = 1; x + 1 < truth.width(); ++x) {
      float sum = 0.0F;
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) sum += truth.at(x + i, y + j) * static_cast<float>((2 - std::abs(i)) * (2 - std::abs(j)));
      }
      out.at(x, y) = sum / 16.0F;
    }
  }
  return out;
}

// truth_from_sensor of frame t (sensor ROI pixels, truth cells at 3:1).
Affine TrueView(const Settings& s, int t, const Eigen::Vector2d& origin) {
  const double time = t;
  const double angle = 0.01 * std::sin(0.05 * time) + 0.0005 * time * 0;
  const double scale = 3.0 * (1.0 + 0.01 * std::sin(0.031 * time));
  Affine a;
  a.linear << scale * std::cos(angle), -scale * std::sin(angle) * 1.02, scale * std::sin(angle), scale * std::cos(angle);
  const Eigen::Vector2d centre(0.5 * (s.roi - 1), 0.5 * (s.roi - 1));
  const Eigen::Vector2d target = origin + 3.0 * Eigen::Vector2d(s.speed_px * time + 0.3 * std::sin(1.7 * time), 4.0 * std::sin(0.11 * time) + 0.4 * std::sin(2.3 * time));
  a.offset = target - a.linear * centre;
  return a;
}

Image<float> Render(const Image<float>& truth, const Settings& s, const Affine& truth_from_sensor, double gain, double offset, int t) {
  // Dense quadrature of Gaussian * box: 7 x 7 per axis over the box convolved with 7 Gaussian nodes folded into one 1-D rule.
  std::vector<double> nodes, weights;
  double total = 0.0;
  for (double x = -3.0 * s.psf - 0.45; x <= 3.0 * s.psf + 0.45 + 1e-9; x += 1.0 / 12.0) {
    const auto cdf = [](double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); };
    nodes.push_back(x);
    weights.push_back(cdf((x + 0.45) / s.psf) - cdf((x - 0.45) / s.psf));
    total += weights.back();
  }
  Rng rng({s.seed, 5, static_cast<std::uint64_t>(t)});
  Image<float> frame(s.roi, s.roi);
  for (int v = 0; v < s.roi; ++v) {
    for (int u = 0; u < s.roi; ++u) {
      double sum = 0.0;
      for (std::size_t j = 0; j < nodes.size(); ++j) {
        for (std::size_t i = 0; i < nodes.size(); ++i) {
          const Eigen::Vector2d x = truth_from_sensor * Eigen::Vector2d(u + nodes[i], v + nodes[j]);
          sum += weights[i] * weights[j] * SampleCubic(truth, x.x(), x.y());
        }
      }
      frame.at(u, v) = static_cast<float>(gain * sum / (total * total) + offset + s.noise * rng.Normal());
    }
  }
  return frame;
}

struct Score {
  double psnr = 0.0;
  double rmse = 0.0;
};

// PSNR of `image` on the truth's own grid after one gain and offset, where mask > 0.
double Psnr(const std::vector<double>& x, const std::vector<double>& y) {
  double sx = 0, sy = 0, sxx = 0, sxy = 0;
  const double n = static_cast<double>(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    sx += x[i]; sy += y[i]; sxx += x[i] * x[i]; sxy += x[i] * y[i];
  }
  const double gain = (n * sxy - sx * sy) / (n * sxx - sx * sx);
  const double offset = (sy - gain * sx) / n;
  double sse = 0;
  for (std::size_t i = 0; i < x.size(); ++i) sse += std::pow(gain * x[i] + offset - y[i], 2);
  return 10 * std::log10(255.0 * 255.0 * n / sse);
}

int Main(int argc, char** argv) {
  Settings s;
  CLI::App app("Quality of the engine on one ROI with known truth");
  app.add_option("truth", s.truth);
  app.add_option("--frames", s.frames);
  app.add_option("--roi", s.roi);
  app.add_option("--speed", s.speed_px);
  app.add_option("--noise", s.noise);
  app.add_option("--psf", s.psf);
  app.add_option("--model-psf", s.model_psf);
  app.add_option("--seed", s.seed);
  app.add_option("--weight", s.weight);
  app.add_option("--forgetting", s.forgetting);
  app.add_option("--iterations", s.iterations);
  app.add_option("--method", s.method);
  app.add_option("--picture", s.picture);
  app.add_option("--truth-x", s.truth_x);
  app.add_option("--truth-y", s.truth_y);
  app.add_flag("--exact-motion", s.exact_motion);
  CLI11_PARSE(app, argc, argv);

  const int need_w = static_cast<int>(3 * (s.roi + s.speed_px * s.frames)) + 120, need_h = 3 * s.roi + 120;
  Image<float> truth;
  if (s.truth.empty()) {
    truth = ProceduralTruth(need_w, need_h, s.seed);
  } else {
    const cv::Mat full = cv::imread(s.truth, cv::IMREAD_GRAYSCALE);
    if (full.empty() || s.truth_x + need_w > full.cols || s.truth_y + need_h > full.rows) {
      std::fprintf(stderr, "%s: need %d x %d from (%d, %d)\n", s.truth.c_str(), need_w, need_h, s.truth_x, s.truth_y);
      return 3;
    }
    truth = FromMat(full(cv::Rect(s.truth_x, s.truth_y, need_w, need_h)));
  }
  const Eigen::Vector2d origin(0.5 * 3 * s.roi + 50, 0.5 * need_h);
  const Roi roi{0, 0, s.roi, s.roi};
  std::vector<FrameInput> frames(static_cast<std::size_t>(s.frames));
  std::vector<Affine> views;
  Rng motion_rng({s.seed, 9});
  for (int t = 0; t < s.frames; ++t) {
    views.push_back(TrueView(s, t, origin));
    FrameInput& f = frames[static_cast<std::size_t>(t)];
    f.frame_index = t;
    f.pixels = Render(truth, s, views.back(), 1.0 + 0.05 * std::sin(0.07 * t), 4.0 * std::sin(0.05 * t), t);
    if (t > 0) {
      Affine m = views[static_cast<std::size_t>(t - 1)].Inverse() * views.back();
      m.offset += 0.3 * Eigen::Vector2d(motion_rng.Normal(), motion_rng.Normal());
      f.previous_from_current = m;
    }
  }
  EngineOptions options;
  options.psf.sigma_px = s.model_psf > 0 ? s.model_psf : s.psf;
  options.noise_sigma = s.noise;
  options.noise_known = false;
  options.structure_weight = s.weight;
  options.forgetting = s.forgetting;
  options.iterations = s.iterations;
  options.registration = s.method == "hints" ? RegistrationMethod::kHints : s.method == "hintsgn" ? RegistrationMethod::kHintsThenGaussNewton : RegistrationMethod::kAuto;

  const Image<float> filtered = Filtered121(truth);
  const Affine truth_from_scene0 = [&] {
    Affine nominal;
    nominal.linear *= 3.0;
    return views[0] * nominal.Inverse();
  }();
  cv::Mat last;
  const SnapshotSink sink = [&](int segment, const SceneSnapshot& snap) {
    std::vector<double> a[6], b[6], bic, bic_truth;
    const Image<float>& f0 = frames[0].pixels;
    for (int y = 40; y < truth.height() - 40; y += 1) {
      for (int x = 40; x < truth.width() - 40; x += 1) {
        const Eigen::Vector2d c = truth_from_scene0.Inverse() * Eigen::Vector2d(x, y) - Eigen::Vector2d(snap.extent.x0, snap.extent.y0);
        if (!CubicSupported(snap.intensity, c.x(), c.y())) continue;
        const float info = snap.information.at(static_cast<int>(c.x() + .5), static_cast<int>(c.y() + .5));
        bool whole = true;
        for (int j = -1; j <= 2 && whole; ++j) for (int i = -1; i <= 2; ++i) whole = whole && snap.information.at(static_cast<int>(c.x()) + i, static_cast<int>(c.y()) + j) > 0.9F;
        if (!whole) continue;
        const int bin = info < 2.5 ? 0 : info < 6 ? 1 : info < 12 ? 2 : info < 25 ? 3 : info < 45 ? 4 : 5;
        a[bin].push_back(SampleCubic(snap.intensity, c.x(), c.y()));
        b[bin].push_back(filtered.at(x, y));
        const Eigen::Vector2d u = views[0].Inverse() * Eigen::Vector2d(x, y);
        if (CubicSupported(f0, u.x(), u.y())) {
          bic.push_back(SampleCubic(f0, u.x(), u.y()));
          bic_truth.push_back(filtered.at(x, y));
        }
      }
    }
    std::printf("snapshot %d.%d frames [%d,%d) PSNR by frames seen <2.5,6,12,25,45,more:", segment, snap.scene_id, snap.frame_begin, snap.frame_end);
    for (int k = 0; k < 6; ++k) std::printf(" %s", a[k].size() > 2000 ? std::to_string(Psnr(a[k], b[k])).substr(0, 5).c_str() : "-");
    std::printf("  bicubic %s\n", bic.size() > 2000 ? std::to_string(Psnr(bic, bic_truth)).substr(0, 5).c_str() : "-");
    last = cv::Mat(snap.intensity.height(), snap.intensity.width(), CV_32F, const_cast<float*>(snap.intensity.row(0))).clone();
    return Status{};
  };
  const auto begin = std::chrono::steady_clock::now();
  const Result<EngineResult> result = RunMapping(roi, frames, options, sink, {});
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  if (!result.ok()) {
    std::fprintf(stderr, "%s\n", result.status().ToString().c_str());
    return 1;
  }
  std::vector<double> errors;
  double chi2 = 0; int chin = 0;
  for (const ChainEntry& e : result->segments[0].chain) {
    const Affine expected = truth_from_scene0.Inverse() * views[static_cast<std::size_t>(e.frame_index)];
    errors.push_back(LargestCornerMotion(e.registration.view.scene_from_sensor, expected, roi));
    if (e.frame_index > 5) {
      const CornerVector d = CornerDisplacement(e.registration.view.scene_from_sensor, expected, roi);
      chi2 += d.dot(e.registration.corner_covariance.ldlt().solve(d)) / 6; ++chin;
    }
    if (e.frame_index % std::max(1, s.frames / 8) == 0)
      std::printf("frame %3d corner error %.4f px gain %.4f (true %.4f) rms %.2f corr %.3f overlap %.2f sd %.4f\n", e.frame_index, errors.back(), e.registration.view.gain,
                  1.0 + 0.05 * std::sin(0.07 * e.frame_index), e.registration.residual_rms, e.registration.correlation, e.registration.overlap, std::sqrt(e.registration.corner_covariance(0,0)));
  }
  std::sort(errors.begin(), errors.end());
  int lost = 0;
  for (const auto& f : result->frames) lost += f.outcome == FrameReport::Outcome::kLost;
  std::printf("segments %zu chain %zu lost %d; corner error median %.4f p95 %.4f last-ish max %.4f px; chi2/dof %.2f; noise %.2f; %.1f ms/frame\n", result->segments.size(),
              result->segments[0].chain.size(), lost, errors[errors.size() / 2], errors[errors.size() * 95 / 100], errors.back(), chin ? chi2 / chin : 0.0, result->noise_sigma,
              1e3 * seconds / s.frames);
  if (!s.picture.empty()) cv::imwrite(s.picture, last);
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) { return trem::Main(argc, argv); }
