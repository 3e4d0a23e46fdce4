// Question: how fine are the bars that can still be told apart, and how far does a long chain of registrations drift?
// Bars: boards of bars of known frequency (tests/bench/peers/bar_chart.h) under a dwelling camera; a frequency counts as resolved when
// the bars of both directions keep more than 10 % of their modulation and correlate with the truth by more than 0.6, and so do all lower
// ones. Peers: the bicubic frame and the best maximum a posteriori scene of one frame. Median over the seeds.
// Drift: the camera crosses new ground at 1.9 px a frame; the error is the largest of a ROI corner against the truth, in the gauge of
// frame 0, median of the last ten frames. Peer: the chain of converged cv::findTransformECC calls between successive frames, on the same
// frames and started from the same motion.
//
// usage: resolution_bench [--seeds N] [--only bars|drift]; see --help
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "tests/bench/peers/bar_chart.h"
#include "tests/bench/peers/ecc.h"
#include "tests/bench/peers/engine_peer.h"
#include "tests/bench/peers/tuned_map.h"
#include "worker/simulate/truth.h"

namespace trem::bench {
namespace {

constexpr double kDriftSpeedPx = 1.9;
constexpr std::size_t kLastFrames = 10;

struct Settings {
  int seeds = 3;
  int frames = 60;
  int drift_frames = 200;
  std::string only;
  bool list = false;
};

double Median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

void PrintBars(const char* name, const std::vector<double>& highest) {
  fmt::print("{:<28} {:.2f} bars a pixel ({:.2f} .. {:.2f} over the seeds)\n", name, Median(highest),
             *std::min_element(highest.begin(), highest.end()), *std::max_element(highest.begin(), highest.end()));
}

void ListBars(const char* name, const Image<float>& answer, const BarChart& chart) {
  for (const BarBoard& board : chart.boards) {
    const BarReading reading = ReadBars(answer, board);
    fmt::print("  {} {:.2f} {}: modulation {:.3f} correlation {:.2f}\n", name, board.frequency, board.upright ? "upright" : "lying",
               reading.modulation, reading.correlation);
  }
}

Status Bars(const Settings& s, double psf_sigma_px, double at_least, double aim) {
  std::vector<double> bicubic, map, engine;
  for (int seed = 1; seed <= s.seeds; ++seed) {
    testing::SequenceOptions options;
    options.motion = testing::CameraMotion::kDwell;
    options.frame_count = s.frames;
    options.roi_px = 151;
    options.speed_px = 0.02;
    options.psf_sigma_px = psf_sigma_px;
    options.seed = static_cast<std::uint64_t>(seed);
    const BarChart chart = MakeBarChart(options);
    bicubic.push_back(HighestResolved(Bicubic(chart.scene), chart));
    map.push_back(HighestResolved(TunedMap(chart.scene, 1).answer, chart));
    TREM_ASSIGN_OR_RETURN(const EngineAnswer made, RunEngine(chart.scene, EngineOptions{}));
    engine.push_back(HighestResolved(made.answer, chart));
    if (s.list) ListBars("trem", made.answer, chart);
  }
  fmt::print(
      "\nbars resolved, {} frames, PSF Gaussian {} px and box 0.9 px, noise 2 of 255, {} seeds; the sensor's Nyquist frequency is 0.5\n",
      s.frames, psf_sigma_px, s.seeds);
  PrintBars("bicubic, one frame", bicubic);
  PrintBars("tuned MAP, one frame", map);
  PrintBars("trem, default", engine);
  const double seen = Median(engine);
  fmt::print("promised {:.2f}: {}, aim {:.2f}: {}\n", at_least, seen >= at_least - 1e-9 ? "met" : "NOT MET", aim,
             seen >= aim - 1e-9 ? "met" : "not met");
  return {};
}

// Error of the chain at the end [px]; nothing when the engine broke it.
std::optional<double> EngineDrift(const testing::RenderedSequence& sequence, const EngineResult& result) {
  const std::vector<ChainEntry>& chain = result.segments[0].chain;
  if (chain.size() < sequence.frames.size()) return std::nullopt;
  std::vector<double> errors;
  for (std::size_t k = chain.size() - kLastFrames; k < chain.size(); ++k) errors.push_back(testing::CornerError(sequence, chain[k], 0));
  return Median(errors);
}

double PairwiseDrift(const testing::RenderedSequence& sequence) {
  Affine first_from_current;
  std::vector<double> errors;
  for (std::size_t t = 1; t < sequence.frames.size(); ++t) {
    first_from_current = first_from_current * RegisterEcc(sequence.frames[t - 1], sequence.frames[t], kConvergedEcc).previous_from_current;
    const Affine expected = sequence.truth_from_sensor[0].Inverse() * sequence.truth_from_sensor[t];
    errors.push_back(LargestCornerMotion(first_from_current, expected, sequence.roi));
  }
  return Median({errors.end() - kLastFrames, errors.end()});
}

Status Drift(const Settings& s) {
  std::vector<double> engine, pairwise;
  for (int seed = 1; seed <= s.seeds; ++seed) {
    testing::SequenceOptions options;
    options.frame_count = s.drift_frames;
    options.roi_px = 151;
    options.speed_px = kDriftSpeedPx;
    options.psf_sigma_px = 0.6;
    options.seed = static_cast<std::uint64_t>(seed);
    const testing::RenderedSequence sequence =
        testing::RenderSequence(ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), options.seed), options);
    EngineOptions engine_options;
    engine_options.psf = {options.psf_sigma_px, options.fill_factor};
    const SnapshotSink sink = [](int, const SceneSnapshot&) { return Status{}; };
    TREM_ASSIGN_OR_RETURN(const EngineResult result, RunMapping(sequence.roi, sequence.frames, engine_options, sink, {}));
    const std::optional<double> drift = EngineDrift(sequence, result);
    if (!drift) fmt::print("seed {}: the engine began another scene, so there is no one chain\n", seed);
    engine.push_back(drift.value_or(1e9));
    pairwise.push_back(PairwiseDrift(sequence));
    fmt::print("seed {}: drift after {} frames at {} px a frame: trem {:.4f} px, chain of findTransformECC {:.4f} px\n", seed,
               s.drift_frames, kDriftSpeedPx, engine.back(), pairwise.back());
  }
  fmt::print("median drift: trem {:.4f} px, chain of findTransformECC {:.4f} px; promised 0.05: {}, aim 0.015: {}\n", Median(engine),
             Median(pairwise), Median(engine) <= 0.05 ? "met" : "NOT MET", Median(engine) <= 0.015 ? "met" : "not met");
  return {};
}

Status Run(const Settings& s) {
  cv::setNumThreads(1);
  if (s.only != "drift") {
    TREM_RETURN_IF_ERROR(Bars(s, 0.6, 0.65, 0.75));
    TREM_RETURN_IF_ERROR(Bars(s, 0.35, 0.85, 0.95));
  }
  if (s.only != "bars") TREM_RETURN_IF_ERROR(Drift(s));
  return {};
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  trem::bench::Settings settings;
  CLI::App app("Bars resolved and drift of a long chain, beside peers");
  app.add_option("--seeds", settings.seeds, "Repetitions with other noise, motion and ground")->check(CLI::Range(1, 100));
  app.add_option("--frames", settings.frames, "Frames of the bars' part")->check(CLI::Range(1, 1000));
  app.add_option("--drift-frames", settings.drift_frames, "Frames of the drift's part")->check(CLI::Range(20, 1000));
  app.add_option("--only", settings.only, "One part only")->check(CLI::IsMember({"bars", "drift"}));
  app.add_flag("--list", settings.list, "Every board's modulation and correlation, too");
  CLI11_PARSE(app, argc, argv);
  const trem::Status status = trem::bench::Run(settings);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
