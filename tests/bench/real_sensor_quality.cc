// Question: what does each fault of a real sensor or scene cost the engine, and how much of it does the engine win back by itself?
// Method: one rendered sequence (tests/support/rendered_sequence.h), the fault put in (tests/support/sensor_faults.h), the engine with its
// corrections off and on. Columns: PSNR of the scene on cells that at least 12 frames have seen, against the truth filtered by [1 2 1]/4;
// largest rms error over a block of 5 x 5 sensor pixels; part of the pixels masked as moving; error of a ROI corner, median and
// 95th percentile; frames registered; ms a frame.
//
// usage: real_sensor_quality [options]; see --help
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "tests/support/rendered_sequence.h"
#include "tests/support/sensor_faults.h"
#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Row {
  std::string name;
  std::function<void(RenderedSequence*)> spoil;
};

std::vector<Row> Rows(int roi_px) {
  const double centre = 0.5 * roi_px;
  const auto mover = [centre](double grey, int begin, int end) {
    return [=](RenderedSequence* s) {
      // The scene passes through the ROI against x; this one keeps in it.
      testing::AddMover({15.0, grey, centre - 20.0, centre - 10.0, 0.6, 0.4, begin, end}, s);
      testing::AddMover({7.0, 255.0 - grey, centre + 15.0, centre + 20.0, -0.9, -0.3, begin, end}, s);
    };
  };
  return {
      {"clean", [](RenderedSequence*) {}},
      {"fixed pattern sigma 4", [](RenderedSequence* s) { testing::AddFixedPattern(4.0, 5, s); }},
      {"fixed pattern sigma 1", [](RenderedSequence* s) { testing::AddFixedPattern(1.0, 5, s); }},
      {"bad pixels 0.5 %", [](RenderedSequence* s) { testing::AddBadPixels(0.005, 5, s); }},
      {"pattern 4 and bad 0.5 %",
       [](RenderedSequence* s) {
         testing::AddFixedPattern(4.0, 5, s);
         testing::AddBadPixels(0.005, 5, s);
       }},
      {"two movers, all frames", mover(230.0, 0, 1 << 30)},
      {"two movers, frames 0-5", mover(230.0, 0, 6)},
      {"two movers, frames 20-40", mover(230.0, 20, 40)},
      {"gain x 2, offset + 40", [](RenderedSequence* s) { testing::JumpBrightness(2.0, 40.0, 20, s); }},
      {"clipped at 170, weighted", [](RenderedSequence* s) { testing::Saturate(170.0, true, s); }},
      {"clipped at 170, unweighted", [](RenderedSequence* s) { testing::Saturate(170.0, false, s); }},
  };
}

struct Figures {
  double scene_db = 0.0;
  double worst_block = 0.0;
  double median_px = 0.0;
  double p95_px = 0.0;
  int registered = 0;
  double ms = 0.0;
  EngineResult result;
};

// Largest rms error [grey levels] of the scene over a block of 15 x 15 truth cells (5 x 5 sensor pixels) that at least 12 frames have seen
// all over. The scene's gauge is the first frame's gain and offset.
double WorstBlock(const RenderedSequence& sequence, const Image<float>& filtered, const SceneSnapshot& snapshot) {
  constexpr int kSide = 15;
  const Affine scene_from_truth = sequence.TruthFromScene(0).Inverse();
  double worst = 0.0;
  for (int top = 1; top + kSide < filtered.height(); top += kSide) {
    for (int left = 1; left + kSide < filtered.width(); left += kSide) {
      double squares = 0.0;
      bool seen = true;
      for (int y = top; y < top + kSide && seen; ++y) {
        for (int x = left; x < left + kSide && seen; ++x) {
          const Eigen::Vector2d cell = scene_from_truth * Eigen::Vector2d(x, y) - Eigen::Vector2d(snapshot.extent.x0, snapshot.extent.y0);
          seen = CubicSupported(snapshot.intensity, cell.x(), cell.y()) &&
                 snapshot.information.at(static_cast<int>(cell.x() + 0.5), static_cast<int>(cell.y() + 0.5)) >= 12.0F;
          if (!seen) break;
          const double expected = sequence.gains[0] * filtered.at(x, y) + sequence.offsets[0];
          squares += std::pow(SampleCubic(snapshot.intensity, cell.x(), cell.y()) - expected, 2);
        }
      }
      if (seen) worst = std::max(worst, std::sqrt(squares / (kSide * kSide)));
    }
  }
  return worst;
}

Figures Measure(const RenderedSequence& sequence, const Image<float>& filtered, const EngineOptions& options) {
  Figures figures;
  std::vector<double> db;
  const auto start = std::chrono::steady_clock::now();
  double scoring_s = 0.0;
  const auto seconds = [](auto since) { return std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count(); };
  const SnapshotSink sink = [&](int segment, const SceneSnapshot& snapshot) {
    const auto scoring = std::chrono::steady_clock::now();
    const auto score = segment == 0 ? testing::ScoreSnapshot(sequence, filtered, snapshot, 0, 12.0, 1e9).scene_db : std::nullopt;
    if (score) db.push_back(*score);
    if (segment == 0) figures.worst_block = std::max(figures.worst_block, WorstBlock(sequence, filtered, snapshot));
    scoring_s += seconds(scoring);
    return Status{};
  };
  Result<EngineResult> result = RunMapping(sequence.roi, sequence.frames, options, sink, {});
  figures.ms = 1e3 * (seconds(start) - scoring_s) / static_cast<double>(sequence.frames.size());
  TREM_CHECK_MSG(result.ok(), result.status().message());
  figures.result = std::move(*result);
  for (const double value : db) figures.scene_db += value / static_cast<double>(db.size());
  std::vector<double> errors;
  for (const ChainEntry& entry : figures.result.segments[0].chain) errors.push_back(testing::CornerError(sequence, entry, 0));
  std::sort(errors.begin(), errors.end());
  figures.median_px = errors[errors.size() / 2];
  figures.p95_px = errors[errors.size() * 95 / 100];
  figures.registered = static_cast<int>(errors.size());
  return figures;
}

void Print(const char* name, const char* corrections, const Figures& f) {
  std::printf("%-28s %-4s %6.2f dB  worst %5.1f  masked %5.2f %%  %.4f %.4f px  %3d frames  %5.2f ms\n", name, corrections, f.scene_db,
              f.worst_block,
              100.0 * static_cast<double>(f.result.masked_pixels) / static_cast<double>(std::max<long long>(f.result.used_pixels, 1)),
              f.median_px, f.p95_px, f.registered, f.ms);
  const auto lost = std::find_if(f.result.frames.begin(), f.result.frames.end(), [](const FrameReport& r) { return !r.reason.empty(); });
  if (lost != f.result.frames.end()) std::printf("    frame %d: %s\n", lost->frame_index, lost->reason.c_str());
  for (const EngineNote& note : f.result.notes)
    std::printf("    note %s, frame %d: %s\n", note.code.c_str(), note.frame_index, note.text.c_str());
  std::fflush(stdout);
}

int Run(const SequenceOptions& sequence_options, const std::string& only, bool only_on) {
  const RenderedSequence clean = testing::RenderSequence(sequence_options);
  const Image<float> filtered = testing::Filtered121(clean.truth);
  for (const Row& row : Rows(sequence_options.roi_px)) {
    if (row.name.find(only) == std::string::npos) continue;
    RenderedSequence sequence = clean;
    row.spoil(&sequence);
    EngineOptions options;
    options.psf.sigma_px = sequence_options.psf_sigma_px;
    options.noise_sigma = sequence_options.noise_sigma;
    if (!only_on) {
      EngineOptions off = options;
      off.detector_bias = off.mover_mask = Correction::kOff;
      Print(row.name.c_str(), "off", Measure(sequence, filtered, off));
    }
    options.mover_mask = Correction::kOn;
    Print(row.name.c_str(), "on", Measure(sequence, filtered, options));
  }
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::testing::SequenceOptions options;
  options.frame_count = 60;
  options.roi_px = 101;
  options.speed_px = 1.9;
  options.psf_sigma_px = 0.6;
  std::string only;
  bool only_on = false;
  CLI::App app("What faults of real sensors cost, and what the engine wins back");
  app.add_option("--frames", options.frame_count, "Frames");
  app.add_option("--roi", options.roi_px, "Side of the ROI, sensor pixels");
  app.add_option("--speed", options.speed_px, "Motion a frame, sensor pixels");
  app.add_option("--noise", options.noise_sigma, "Grey levels");
  app.add_option("--seed", options.seed, "Of noise and terrain");
  app.add_option("--only", only, "Rows whose name contains this");
  app.add_flag("--on", only_on, "Only with the corrections");
  CLI11_PARSE(app, argc, argv);
  return trem::Run(options, only, only_on);
}
