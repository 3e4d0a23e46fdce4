// Question: how much of the scene's true error lies within one and two of the standard deviations that `trem enhance` reports, by noise and
// number of frames? Nominal: 68.3 and 95.4 %. Method: dwelling sequences of procedural ground and of random crops of a photograph, truth
// filtered by [1 2 1] / 4; several seeds, each a scene of its own, so that the spread over seeds tests the mean: |t| is the mean's distance
// from nominal in its standard errors. Baseline: what an error of one standard deviation everywhere (that of the whole scene) would cover.
//
// usage: sigma_coverage [TRUTH_IMAGE] [options]; see --help
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "worker/sensor/bicubic.h"
#include "worker/simulate/truth.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Settings {
  std::string truth;
  std::vector<double> noises{1.0, 2.0, 4.0, 8.0};
  std::vector<int> frames{10, 30, 100};
  int seeds = 8;
  int first_seed = 101;
  int roi_px = 41;
};

struct Covered {
  std::vector<double> one;
  std::vector<double> two;
  std::vector<double> rms_error;
  std::vector<double> rms_sigma;
};

SceneSnapshot Made(const RenderedSequence& sequence, double noise_sigma) {
  EngineOptions options;
  options.uncertainty = true;
  options.noise_sigma = noise_sigma;
  SceneSnapshot last;
  const SnapshotSink sink = [&](int, const SceneSnapshot& snapshot) {
    last = snapshot;
    return Status{};
  };
  const Result<EngineResult> result = RunMapping(sequence.roi, sequence.frames, options, sink, {});
  TREM_CHECK_MSG(result.ok(), result.status().message());
  return last;
}

void Judge(const RenderedSequence& sequence, const SceneSnapshot& snapshot, double seen_min, Covered* covered) {
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  const Affine truth_from_scene = sequence.TruthFromScene(0);
  double cells = 0.0, one = 0.0, two = 0.0, errors = 0.0, variances = 0.0;
  for (int y = 0; y < snapshot.extent.height(); ++y) {
    for (int x = 0; x < snapshot.extent.width(); ++x) {
      if (!(snapshot.information.at(x, y) > seen_min)) continue;
      const Eigen::Vector2d at = truth_from_scene * Eigen::Vector2d(x + snapshot.extent.x0, y + snapshot.extent.y0);
      const double error = std::abs(snapshot.intensity.at(x, y) - SampleCubic(filtered, at.x(), at.y()));
      const double sigma = snapshot.sigma.at(x, y);
      cells += 1.0;
      one += error < sigma ? 1.0 : 0.0;
      two += error < 2.0 * sigma ? 1.0 : 0.0;
      errors += error * error;
      variances += sigma * sigma;
    }
  }
  TREM_CHECK_MSG(cells > 1000.0, "too few cells were seen by enough frames");
  covered->one.push_back(one / cells);
  covered->two.push_back(two / cells);
  covered->rms_error.push_back(std::sqrt(errors / cells));
  covered->rms_sigma.push_back(std::sqrt(variances / cells));
}

double Mean(const std::vector<double>& v) {
  double sum = 0.0;
  for (const double x : v) sum += x;
  return sum / static_cast<double>(v.size());
}

double StandardError(const std::vector<double>& v) {
  double sum = 0.0;
  for (const double x : v) sum += (x - Mean(v)) * (x - Mean(v));
  return v.size() > 1 ? std::sqrt(sum / static_cast<double>(v.size() - 1) / static_cast<double>(v.size())) : 0.0;
}

void Print(const char* name, double noise, int frames, const Covered& c) {
  const double e1 = StandardError(c.one);
  const double e2 = StandardError(c.two);
  fmt::print("{:<11} {:5.1f} {:6} {:6.1f} +- {:3.1f} {:6.1f} +- {:3.1f}  |t| {:4.1f} {:4.1f}  rms error {:5.2f} sigma {:5.2f}\n", name,
             noise, frames, 100 * Mean(c.one), 100 * e1, 100 * Mean(c.two), 100 * e2, e1 > 0.0 ? std::abs(Mean(c.one) - 0.683) / e1 : 0.0,
             e2 > 0.0 ? std::abs(Mean(c.two) - 0.954) / e2 : 0.0, Mean(c.rms_error), Mean(c.rms_sigma));
  std::fflush(stdout);
}

RenderedSequence Rendered(const Settings& s, const Image<float>& photograph, const SequenceOptions& options) {
  if (photograph.empty()) return testing::RenderSequence(options);
  const int width = testing::TruthWidth(options);
  const int height = testing::TruthHeight(options);
  TREM_CHECK_MSG(photograph.width() > width && photograph.height() > height, s.truth + " is too small");
  Rng rng({options.seed, 78});
  const int x0 = static_cast<int>(rng.UniformIndex(static_cast<std::uint32_t>(photograph.width() - width)));
  const int y0 = static_cast<int>(rng.UniformIndex(static_cast<std::uint32_t>(photograph.height() - height)));
  Image<float> truth(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(photograph.row(y0 + y) + x0, width, truth.row(y));
  return testing::RenderSequence(std::move(truth), options);
}

int Run(const Settings& s) {
  std::vector<Image<float>> photographs(1);
  if (!s.truth.empty()) {
    Result<Image<float>> read = ReadGrey(s.truth);
    if (!read.ok()) {
      std::fprintf(stderr, "%s\n", read.status().ToString().c_str());
      return 1;
    }
    photographs.push_back(std::move(*read));
  }
  fmt::print("scene       noise frames  within 1 sd %   within 2 sd %  (mean +- standard error over {} seeds)\n", s.seeds);
  for (const Image<float>& photograph : photographs) {
    for (const double noise : s.noises) {
      for (const int frames : s.frames) {
        Covered covered;
        for (int k = 0; k < s.seeds; ++k) {
          SequenceOptions options;
          options.frame_count = frames;
          options.roi_px = s.roi_px;
          options.speed_px = 0.12;
          options.noise_sigma = noise;
          options.seed = static_cast<std::uint64_t>(s.first_seed + k);
          const RenderedSequence sequence = Rendered(s, photograph, options);
          Judge(sequence, Made(sequence, noise), 0.5 * std::min(frames, 45), &covered);
        }
        Print(photograph.empty() ? "procedural" : "photograph", noise, frames, covered);
      }
    }
  }
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Settings settings;
  CLI::App app("Coverage of the reported standard deviation");
  app.add_option("truth", settings.truth, "Photograph whose crops are flown over, too");
  app.add_option("--noise", settings.noises, "Grey levels; several");
  app.add_option("--frames", settings.frames, "Numbers of frames; several");
  app.add_option("--seeds", settings.seeds, "Scenes a row")->check(CLI::Range(1, 1000));
  app.add_option("--first-seed", settings.first_seed, "The first of them");
  app.add_option("--roi", settings.roi_px, "Side of the ROI, sensor pixels")->check(CLI::Range(31, 400));
  CLI11_PARSE(app, argc, argv);
  return trem::Run(settings);
}
