// Question: how sharp is the engine's scene beside what else can be made of the same frames?
// Peers in the same run: the bicubic frame; the best Wiener filter and the best maximum a posteriori scene of one frame; shift-and-add
// with the true registration and its best Wiener filter; OpenCV's BTV-L1 super-resolution; the best converged batch scene of all frames
// with the true registration. "Best": tuned to the truth of the very scene, which no user can do, and the better of the scene and the
// scene filtered like the truth. The engine is told the PSF and nothing else.
// Truth: the scene filtered by [1 2 1] / 4 in each axis on the 3:1 grid, which is what such a grid can carry. Score: PSNR after one gain
// and offset, on the cells that every frame sees. Frames come from a denser model than the engine's (tests/support/rendered_sequence.h):
// PSF Gaussian 0.6 px and box 0.9 px, noise 2 grey levels, a dwelling camera with drifting gain and offset.
//
// usage: quality_bench [--truth IMAGE] [--seeds N] [--frames N ...]; see --help
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "tests/bench/peers/engine_peer.h"
#include "tests/bench/peers/quality_scenes.h"
#include "tests/bench/peers/tuned_map.h"
#include "tests/bench/peers/wiener.h"
#ifdef TREM_BENCH_SUPERRES
#include "tests/bench/peers/btv_l1.h"
#endif

namespace trem::bench {
namespace {

struct Settings {
  SceneSettings scenes;
  int seeds = 3;
  std::vector<int> frames = {30};
  int batch_seeds = 1;
  bool skip_btv = false;
  bool tune_btv = false;
};

// PSNR of one method on one kind of scene, over the seeds.
struct Series {
  std::vector<double> db;
  void Add(double value) { db.push_back(value); }
  // Of the first `count`, which a series over fewer seeds has in common with the others.
  double mean(std::size_t count) const {
    double sum = 0.0;
    for (std::size_t i = 0; i < count; ++i) sum += db[i];
    return sum / static_cast<double>(count);
  }
  double mean() const { return mean(db.size()); }
  double sd() const {
    double sum = 0.0;
    for (const double value : db) sum += (value - mean()) * (value - mean());
    return db.size() > 1 ? std::sqrt(sum / static_cast<double>(db.size() - 1)) : 0.0;
  }
};

// Methods in the order of their rows.
enum Method {
  kBicubic,
  kWiener,
  kSingleMap,
  kShiftAndAdd,
  kShiftAndAddWiener,
  kBtvL1,
  kBatchMap,
  kLandweber,
  kEngine,
  kEngineFiltered,
  kMethodCount
};
constexpr const char* kMethodNames[] = {"bicubic, one frame",
                                        "tuned Wiener, one frame",
                                        "tuned MAP, one frame",
                                        "shift-and-add, true registration",
                                        "the same + tuned Wiener",
                                        "OpenCV superres BTV-L1, tuned",
                                        "tuned batch MAP, true registration",
                                        "the paper's scheme, trem LANDWEBER 1",
                                        "trem, default",
                                        "the same, filtered like the truth"};

using Table = std::array<Series, kMethodCount>;

#ifdef TREM_BENCH_SUPERRES
// Its output pixel 3 u lies on the pixel u itself, so no shift is expected; half a pixel either way is searched all the same.
double BtvScore(const BenchScene& scene, const BtvSettings& settings, double* seconds) {
  const BtvAnswer btv = RunBtv(scene, settings);
  *seconds = btv.seconds;
  return std::max(ScoreAtBestShift(scene, btv.answer, 0.0, 0.0).db, ScoreAtBestShift(scene, testing::Filtered121(btv.answer), 0.0, 0.0).db);
}

// The best for these scenes by --tune-btv, within what the frames allow.
BtvSettings TunedBtv(int frames) {
  BtvSettings settings;
  settings.radius = std::min(4, (frames - 1) / 2);
  settings.lambda = 0.003;
  settings.tau = 6.0;
  return settings;
}

void TuneBtv(const BenchScene& scene) {
  for (const int radius : {4, 14}) {
    if (2 * radius + 1 > scene.options.frame_count) continue;
    for (const int iterations : {180, 500}) {
      for (const double lambda : {0.001, 0.003, 0.01}) {
        for (const double tau : {1.3, 3.0, 6.0, 12.0}) {
          double seconds = 0.0;
          BtvSettings settings;
          settings.radius = radius;
          settings.iterations = iterations;
          settings.lambda = lambda;
          settings.tau = tau;
          const double db = BtvScore(scene, settings, &seconds);
          fmt::print("{:<24} radius {:2} iterations {:3} lambda {:.4f} tau {:.1f}: {:.2f} dB, {:.1f} s\n", scene.name, radius, iterations,
                     lambda, tau, db, seconds);
          std::fflush(stdout);
        }
      }
    }
  }
}
#endif

// The paper's scheme: a gradient step of the whole scene on every frame alone, in this engine. False where the engine has no such option.
template <typename Options>
bool ChoosePaperScheme(Options* options) {
  if constexpr (requires { options->landweber_window; }) {
    options->update = decltype(options->update)::kLandweber;
    options->landweber_window = 1;
    return true;
  }
  return false;
}

Status RunScene(const Settings& s, const BenchScene& scene, Table* table) {
#ifdef TREM_BENCH_SUPERRES
  if (s.tune_btv) {
    TuneBtv(scene);
    return {};
  }
#endif
  const Image<float> bicubic = Bicubic(scene);
  (*table)[kBicubic].Add(Score(scene, bicubic));
  (*table)[kWiener].Add(TunedWiener(scene, bicubic).db);
  (*table)[kSingleMap].Add(TunedMap(scene, 1).db);
  const Image<float> fused = ShiftAndAdd(scene);
  (*table)[kShiftAndAdd].Add(Score(scene, fused));
  (*table)[kShiftAndAddWiener].Add(TunedWiener(scene, fused).db);
#ifdef TREM_BENCH_SUPERRES
  if (!s.skip_btv && scene.options.frame_count >= 3) {
    double seconds = 0.0;
    (*table)[kBtvL1].Add(BtvScore(scene, TunedBtv(scene.options.frame_count), &seconds));
  }
#endif
  if (scene.options.seed <= static_cast<std::uint64_t>(s.batch_seeds)) {
    (*table)[kBatchMap].Add(TunedMap(scene, scene.options.frame_count).db);
  }
  if (EngineOptions paper; ChoosePaperScheme(&paper)) {
    TREM_ASSIGN_OR_RETURN(const EngineAnswer answer, RunEngine(scene, paper));
    (*table)[kLandweber].Add(std::max(Score(scene, answer.answer), Score(scene, testing::Filtered121(answer.answer))));
  }
  TREM_ASSIGN_OR_RETURN(const EngineAnswer engine, RunEngine(scene, EngineOptions{}));
  (*table)[kEngine].Add(Score(scene, engine.answer));
  (*table)[kEngineFiltered].Add(Score(scene, testing::Filtered121(engine.answer)));
  if (engine.lost > 0) fmt::print("{}, seed {}: the engine lost {} frames\n", scene.name, scene.options.seed, engine.lost);
  return {};
}

void PrintTables(const std::vector<std::pair<std::string, Table>>& tables) {
  fmt::print("{:<34}", "PSNR, dB: mean +- sd over seeds");
  for (const auto& [name, table] : tables) fmt::print(" {:>24}", name);
  fmt::print("\n");
  for (int method = 0; method < kMethodCount; ++method) {
    fmt::print("{:<34}", kMethodNames[method]);
    for (const auto& [name, table] : tables) {
      const Series& series = table[static_cast<std::size_t>(method)];
      fmt::print(" {:>24}", series.db.empty() ? "-" : fmt::format("{:.2f} +- {:.2f}", series.mean(), series.sd()));
    }
    fmt::print("\n");
  }
}

// One line of what the project promises: the smallest over the scenes of the mean difference, against its bound and its aim.
void PrintPromise(const std::vector<std::pair<std::string, Table>>& tables, Method peer, double at_least, double aim, bool natural) {
  double smallest = 1e9;
  for (const auto& [name, table] : tables) {
    const Series& other = table[static_cast<std::size_t>(peer)];
    if ((name != "procedural") != natural || other.db.empty()) continue;
    smallest = std::min(smallest, table[kEngine].mean(other.db.size()) - other.mean());
  }
  if (smallest > 1e8) return;
  fmt::print("{:<10} above {:<34} {:+.2f} dB  at least {:.1f}: {:<7}  aim {:.1f}: {}\n", natural ? "natural" : "procedural",
             kMethodNames[peer], smallest, at_least, smallest >= at_least ? "met" : "NOT MET", aim, smallest >= aim ? "met" : "not met");
}

Status RunFrames(const Settings& s, int frames) {
  std::vector<std::pair<std::string, Table>> tables;
  SceneSettings scenes = s.scenes;
  scenes.frames = frames;
  for (int seed = 1; seed <= s.seeds; ++seed) {
    std::size_t next = 0;
    TREM_RETURN_IF_ERROR(ForEachScene(scenes, seed, [&](const BenchScene& scene) {
      if (next == tables.size()) tables.emplace_back(scene.name, Table{});
      return RunScene(s, scene, &tables[next++].second);
    }));
  }
  if (s.tune_btv) return {};
  fmt::print("\n{} frames of {} x {} px, 3:1, PSF Gaussian {} px and box 0.9 px, noise {} of 255, {} seeds\n", frames, scenes.roi_px,
             scenes.roi_px, scenes.psf_sigma_px, scenes.noise_sigma, s.seeds);
  PrintTables(tables);
  if (frames == 30) {
    PrintPromise(tables, kBicubic, 4.5, 5.5, false);
    PrintPromise(tables, kBicubic, 3.0, 3.8, true);
    PrintPromise(tables, kSingleMap, 2.0, 2.6, false);
    PrintPromise(tables, kSingleMap, 1.5, 2.2, true);
    PrintPromise(tables, kBtvL1, 2.0, 3.0, false);
    PrintPromise(tables, kBtvL1, 2.0, 3.0, true);
    PrintPromise(tables, kBatchMap, -0.2, 0.0, false);
    PrintPromise(tables, kBatchMap, -0.2, 0.0, true);
  }
  return {};
}

Status Run(const Settings& s) {
  if (s.scenes.truth.empty()) fmt::print("without --truth: the procedural scene only\n");
  for (const int frames : s.frames) TREM_RETURN_IF_ERROR(RunFrames(s, frames));
  return {};
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  trem::bench::Settings settings;
  CLI::App app("Quality of the engine beside its peers, on scenes with known truth");
  settings.scenes.Declare(&app);
  app.add_option("--seeds", settings.seeds, "Repetitions with other noise, motion and procedural ground")->check(CLI::Range(1, 100));
  app.add_option("--frames", settings.frames, "Numbers of frames")->check(CLI::Range(1, 1000));
  app.add_option("--batch-seeds", settings.batch_seeds, "Seeds for which the batch scene is computed, too (a minute each)");
  app.add_flag("--skip-btv", settings.skip_btv, "Leave out OpenCV's method, which takes seconds a frame");
  app.add_flag("--tune-btv", settings.tune_btv, "Only print OpenCV's method over a grid of its settings");
  CLI11_PARSE(app, argc, argv);
  const trem::Status status = trem::bench::Run(settings);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
