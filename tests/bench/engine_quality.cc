// Question: how much sharper than one bicubic frame is the engine's scene, how well does it register, and what does a frame cost?
// Baseline: the first frame enlarged bicubically, placed with its true view. Truth: the scene filtered by [1 2 1]/4 in each axis on the
// 3:1 grid, which is what such a grid can carry. Frames are rendered from the truth by a denser model than the engine's own
// (tests/support/rendered_sequence.h) along a smooth path with rotation, zoom, gain and offset drift.
//
// usage: engine_quality [TRUTH_IMAGE] [options]; see --help
#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/support/rendered_sequence.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

// Limits of the classes of cells by how many frames have seen them.
constexpr double kSeenLimits[] = {0.0, 2.5, 6.0, 12.0, 25.0, 45.0, 1e9};
// Frames at the start of a chain whose covariance is not judged: the scene is one frame's then.
constexpr int kFramesBeforeJudging = 5;

struct Settings {
  SequenceOptions sequence;
  EngineOptions engine;
  std::string truth;
  std::string picture;
  double model_psf = 0.0;  // The engine's belief; 0: the true one.
  int truth_x = 1000;
  int truth_y = 300;
  bool exact_motion = false;
};

void Declare(CLI::App* app, Settings* s) {
  static const std::map<std::string, RegistrationMethod> kMethods = {{"auto", RegistrationMethod::kAuto},
                                                                     {"gn", RegistrationMethod::kGaussNewton},
                                                                     {"hints", RegistrationMethod::kHints},
                                                                     {"hintsgn", RegistrationMethod::kHintsThenGaussNewton},
                                                                     {"pairwise", RegistrationMethod::kPairwise}};
  s->sequence.frame_count = 100;
  s->sequence.roi_px = 151;
  s->sequence.speed_px = 1.9;
  s->sequence.psf_sigma_px = 0.6;
  app->add_option("truth", s->truth, "Picture to fly over; default: procedural");
  app->add_option("--frames", s->sequence.frame_count, "Frames");
  app->add_option("--roi", s->sequence.roi_px, "Side of the ROI, sensor pixels");
  app->add_option("--speed", s->sequence.speed_px, "Motion a frame, sensor pixels");
  app->add_option("--noise", s->sequence.noise_sigma, "Grey levels");
  app->add_option("--psf", s->sequence.psf_sigma_px, "True Gaussian part of the PSF, sensor pixels");
  app->add_option("--model-psf", s->model_psf, "What the engine believes it is; 0: the truth");
  app->add_option("--seed", s->sequence.seed, "Of noise and terrain");
  app->add_option("--weight", s->engine.structure_weight, "Factor on the regularisation");
  app->add_option("--forgetting", s->engine.forgetting, "Per frame; 0: automatic");
  app->add_option("--iterations", s->engine.iterations, "Per frame; 0: automatic");
  app->add_option("--method", s->engine.registration, "auto, gn, hints, hintsgn or pairwise")->transform(CLI::CheckedTransformer(kMethods));
  app->add_option("--picture", s->picture, "Write the last snapshot to this file");
  app->add_option("--truth-x", s->truth_x, "Left column of the part of TRUTH that is used");
  app->add_option("--truth-y", s->truth_y, "Its upper row");
  app->add_flag("--exact-motion", s->exact_motion, "The engine is told the true motion");
}

Image<float> FromMat(const cv::Mat& grey) {
  Image<float> image(grey.cols, grey.rows);
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) image.at(x, y) = grey.at<unsigned char>(y, x);
  }
  return image;
}

// An empty image when the picture cannot be read or is too small; says so.
Image<float> LoadTruth(const Settings& s) {
  const int width = testing::TruthWidth(s.sequence);
  const int height = testing::TruthHeight(s.sequence);
  if (s.truth.empty()) return testing::ProceduralTruth(width, height, s.sequence.seed);
  const cv::Mat whole = cv::imread(s.truth, cv::IMREAD_GRAYSCALE);
  if (whole.empty() || s.truth_x < 0 || s.truth_y < 0 || s.truth_x + width > whole.cols || s.truth_y + height > whole.rows) {
    std::fprintf(stderr, "%s: expected a picture with %d x %d pixels from (%d, %d)\n", s.truth.c_str(), width, height, s.truth_x,
                 s.truth_y);
    return {};
  }
  return FromMat(whole(cv::Rect(s.truth_x, s.truth_y, width, height)));
}

std::string Decibels(const std::optional<double>& psnr) {
  if (!psnr) return "-";
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", *psnr);
  return text;
}

void PrintSnapshot(const RenderedSequence& sequence, const Image<float>& filtered, int segment, const SceneSnapshot& snapshot) {
  std::printf("snapshot %d.%d frames [%d,%d) PSNR by frames seen <2.5,6,12,25,45,more:", segment, snapshot.scene_id, snapshot.frame_begin,
              snapshot.frame_end);
  testing::SnapshotScore score;
  for (std::size_t k = 0; k + 1 < std::size(kSeenLimits); ++k) {
    score = testing::ScoreSnapshot(sequence, filtered, snapshot, 0, kSeenLimits[k], kSeenLimits[k + 1]);
    std::printf(" %s", Decibels(score.scene_db).c_str());
  }
  std::printf("  bicubic %s\n", Decibels(score.bicubic_db).c_str());
}

void PrintEntry(const ChainEntry& entry, double corner_error, double true_gain) {
  const Registration& r = entry.registration;
  std::printf("frame %3d corner error %.4f px gain %.4f (true %.4f) rms %.2f corr %.3f overlap %.2f sd %.4f\n", entry.frame_index,
              corner_error, r.view.gain, true_gain, r.residual_rms, r.correlation, r.overlap, std::sqrt(r.corner_covariance(0, 0)));
}

void PrintChain(const RenderedSequence& sequence, const EngineResult& result, double ms_per_frame) {
  const std::vector<ChainEntry>& chain = result.segments[0].chain;
  const int step = std::max<int>(1, static_cast<int>(sequence.frames.size()) / 8);
  std::vector<double> errors;
  double chi2 = 0.0;
  int judged = 0;
  for (const ChainEntry& entry : chain) {
    errors.push_back(testing::CornerError(sequence, entry, 0));
    if (entry.frame_index % step == 0) PrintEntry(entry, errors.back(), sequence.gains[static_cast<std::size_t>(entry.frame_index)]);
    if (entry.frame_index <= kFramesBeforeJudging) continue;
    const Affine expected = sequence.TruthFromScene(0).Inverse() * sequence.truth_from_sensor[static_cast<std::size_t>(entry.frame_index)];
    const CornerVector d = CornerDisplacement(entry.registration.view.scene_from_sensor, expected, sequence.roi);
    chi2 += d.dot(entry.registration.corner_covariance.ldlt().solve(d)) / 6.0;
    ++judged;
  }
  std::sort(errors.begin(), errors.end());
  const auto lost = std::count_if(result.frames.begin(), result.frames.end(),
                                  [](const FrameReport& frame) { return frame.outcome == FrameReport::Outcome::kLost; });
  std::printf("segments %zu chain %zu lost %d; corner error median %.4f p95 %.4f max %.4f px; chi2/dof %.2f; noise %.2f; %.1f ms/frame\n",
              result.segments.size(), chain.size(), static_cast<int>(lost), errors[errors.size() / 2], errors[errors.size() * 95 / 100],
              errors.back(), judged > 0 ? chi2 / judged : 0.0, result.noise_sigma, ms_per_frame);
}

int Run(Settings s) {
  if (s.exact_motion) s.sequence.motion_sigma_px = 0.0;
  s.engine.psf.sigma_px = s.model_psf > 0.0 ? s.model_psf : s.sequence.psf_sigma_px;
  s.engine.noise_sigma = s.sequence.noise_sigma;
  Image<float> truth = LoadTruth(s);
  if (truth.empty()) return 3;
  const RenderedSequence sequence = testing::RenderSequence(std::move(truth), s.sequence);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  Image<float> last;
  double scoring_s = 0.0;
  const auto now = [] { return std::chrono::steady_clock::now(); };
  const auto seconds_since = [&](auto start) { return std::chrono::duration<double>(now() - start).count(); };
  const SnapshotSink sink = [&](int segment, const SceneSnapshot& snapshot) {
    const auto start = now();
    if (segment == 0) PrintSnapshot(sequence, filtered, segment, snapshot);
    last = snapshot.intensity;
    scoring_s += seconds_since(start);
    return Status{};
  };
  const auto start = now();
  const Result<EngineResult> result = RunMapping(sequence.roi, sequence.frames, s.engine, sink, {});
  const double engine_s = seconds_since(start) - scoring_s;
  if (!result.ok()) {
    std::fprintf(stderr, "%s\n", result.status().ToString().c_str());
    return 1;
  }
  PrintChain(sequence, *result, 1e3 * engine_s / s.sequence.frame_count);
  if (!s.picture.empty()) cv::imwrite(s.picture, cv::Mat(last.height(), last.width(), CV_32F, last.row(0)));
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Settings settings;
  CLI::App app("Quality of the engine on one ROI with known truth");
  trem::Declare(&app, &settings);
  CLI11_PARSE(app, argc, argv);
  return trem::Run(settings);
}
