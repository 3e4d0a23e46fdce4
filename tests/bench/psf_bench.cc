// Question: how well is the width of a Gaussian PSF found from the frames' power spectrum, and does its stated error hold?
// Method: frames of leaves, of procedural ground and of random places of photographs, rendered by an independent sensor with known widths.
//
// usage: psf_bench [--picture FILE]... [--places N] [--frames N] [--roi PX]; see --help
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/leaf_truth.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/truth_picture.h"
#include "worker/simulate/truth.h"
#include "worker/tre/psf_estimate.h"

namespace trem::bench {
namespace {

struct Settings {
  std::vector<std::string> pictures;
  int places = 5;
  int frames = 8;
  int roi_px = 201;
  double speed_px = 12.0;
  double noise_sigma = 2.0;
  bool list = false;
};

using MakeTruth = std::function<std::optional<Image<float>>(int width, int height, std::uint64_t seed)>;

// One row of the table: a kind of ground and a width.
bool Row(const Settings& s, const std::string& name, const MakeTruth& make_truth, double sigma_px) {
  double sum = 0.0;
  double squares = 0.0;
  double chi2 = 0.0;
  int used = 0;
  for (int place = 1; place <= s.places; ++place) {
    testing::SequenceOptions options;
    options.frame_count = s.frames;
    options.roi_px = s.roi_px;
    options.psf_sigma_px = sigma_px;
    options.noise_sigma = s.noise_sigma;
    options.speed_px = s.speed_px;
    options.seed = static_cast<std::uint64_t>(place);
    const auto truth = make_truth(testing::TruthWidth(options), testing::TruthHeight(options), options.seed);
    if (!truth) return false;
    FrameSpectrum spectrum;
    for (const FrameInput& frame : testing::RenderSequence(*truth, options).frames) spectrum.Add(frame.pixels);
    const PsfEstimate estimate = EstimatePsfSigma(spectrum, options.fill_factor);
    if (s.list) {
      fmt::print("  {:.3f} +- {:.3f}, noise {:.2f}, exponent {:.2f}, misfit {:.2f} {}\n", estimate.sigma_px, estimate.error_px,
                 estimate.noise_sigma, estimate.scene_exponent, estimate.misfit, estimate.doubt);
    }
    if (!estimate.doubt.empty()) continue;
    ++used;
    const double error = estimate.sigma_px - sigma_px;
    sum += error;
    squares += error * error;
    chi2 += std::pow(error / estimate.error_px, 2);
  }
  if (used == 0) {
    fmt::print("| {} | {:.2f} | 0 of {} | | | |\n", name, sigma_px, s.places);
  } else {
    fmt::print("| {} | {:.2f} | {} of {} | {:+.3f} | {:.3f} | {:.2f} |\n", name, sigma_px, used, s.places, sum / used,
               std::sqrt(squares / used), std::sqrt(chi2 / used));
  }
  return true;
}

bool Table(const Settings& s, const std::string& name, const MakeTruth& make_truth) {
  for (const double sigma_px : {0.35, 0.45, 0.6, 0.8}) {
    if (!Row(s, name, make_truth, sigma_px)) return false;
  }
  return true;
}

int Main(int argc, char** argv) {
  Settings s;
  CLI::App app("The width of the PSF from the frames' spectrum, against truth.", "psf_bench");
  app.add_option("--picture", s.pictures, "Photographs to fly over");
  app.add_option("--places", s.places, "Places of each")->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--frames", s.frames, "Frames a flight")->check(CLI::Range(1, 100))->capture_default_str();
  app.add_option("--roi", s.roi_px, "Side of a frame, pixels")->check(CLI::Range(64, 1000))->capture_default_str();
  app.add_option("--speed", s.speed_px, "Motion a frame, pixels")->capture_default_str();
  app.add_option("--noise", s.noise_sigma, "Grey levels")->capture_default_str();
  app.add_flag("--list", s.list, "Every estimate");
  CLI11_PARSE(app, argc, argv);
  fmt::print(
      "| ground | true, px | used | mean error, px | rms error, px | rms of error / stated |\n| --- | --- | --- | --- | --- | --- |\n");
  Table(s, "leaves", [](int w, int h, std::uint64_t seed) { return testing::LeafTruth(w, h, seed); });
  Table(s, "procedural", [](int w, int h, std::uint64_t seed) { return ProceduralTerrain(w, h, seed); });
  for (const std::string& picture : s.pictures) {
    const cv::Mat whole = cv::imread(picture, cv::IMREAD_GRAYSCALE);
    const auto cut = [&](int w, int h, std::uint64_t seed) -> std::optional<Image<float>> {
      if (whole.cols < w || whole.rows < h) return std::nullopt;
      Rng rng({seed, 0x706c6163});
      const auto x = static_cast<int>(rng.UniformIndex(static_cast<std::uint32_t>(whole.cols - w + 1)));
      const auto y = static_cast<int>(rng.UniformIndex(static_cast<std::uint32_t>(whole.rows - h + 1)));
      return testing::ReadTruthPicture(picture, x, y, w, h);
    };
    if (!Table(s, picture.substr(picture.rfind('/') + 1), cut)) {
      fmt::print(stderr, "psf_bench: {} cannot be read or is smaller than a flight\n", picture);
      return 1;
    }
  }
  return 0;
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) { return trem::bench::Main(argc, argv); }
