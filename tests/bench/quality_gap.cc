// Question: where is what the engine's scene lacks to the converged batch maximum a posteriori scene with the true registration lost?
// By substitution, one part after the other: "recursion" is the information update with its automatic weight, frame by frame, without what
// is done once before a scene is handed out; then true views, iterations to convergence, samples accumulated anew about the final scene,
// and the best of a sweep of weights take the place of the engine's own. Truth and scenes as in quality_bench.
//
// usage: quality_gap [--truth IMAGE] [--seeds N] [--batch]; see --help
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "tests/bench/peers/engine_peer.h"
#include "tests/bench/peers/quality_scenes.h"
#include "tests/bench/peers/tuned_map.h"
#include "tests/support/batch_map.h"
#include "worker/tre/automatic_regularisation.h"
#include "worker/tre/emitted_band.h"
#include "worker/tre/information_update.h"
#include "worker/tre/kept_frames.h"

namespace trem::bench {
namespace {

constexpr int kMarginCells = 24;
// The engine's.
constexpr int kFirstIterations = 20;
constexpr int kIterations = 4;
constexpr int kManyIterations = 300;

// What is substituted.
struct Recipe {
  std::vector<View> views;
  int last_iterations = 12;
  double huber_sigmas = 3.0;
  bool anew = false;                     // Samples are accumulated anew before the last iterations.
  std::optional<StructureWeight> fixed;  // Of the last iterations.
};

struct Outcome {
  double db = 0.0;
  StructureWeight weight;
};

Image<float> Cut(const BenchScene& scene, const Image<float>& wide) {
  Image<float> cut(scene.AnswerSide(), scene.AnswerSide());
  for (int y = 0; y < cut.height(); ++y) std::copy_n(wide.row(y + kMarginCells) + kMarginCells, cut.width(), cut.row(y));
  return cut;
}

Roi Extent(const BenchScene& scene) {
  return {-kMarginCells, -kMarginCells, scene.AnswerSide() + kMarginCells, scene.AnswerSide() + kMarginCells};
}

Image<float> Start(const BenchScene& scene) {
  const Image<float> bicubic = Bicubic(scene);
  const Roi extent = Extent(scene);
  Image<float> start(extent.width(), extent.height());
  for (int y = 0; y < start.height(); ++y) {
    for (int x = 0; x < start.width(); ++x) start.at(x, y) = SampleClamped(bicubic, x - kMarginCells, y - kMarginCells);
  }
  return start;
}

std::vector<View> TrueViews(const BenchScene& scene) {
  std::vector<View> views;
  for (int t = 0; t < scene.options.frame_count; ++t) {
    const auto index = static_cast<std::size_t>(t);
    views.push_back({scene.SceneFromSensor(t), scene.sequence.gains[index], scene.sequence.offsets[index]});
  }
  return views;
}

class Recursion {
 public:
  Recursion(const BenchScene& scene, const Recipe& recipe)
      : scene_(scene),
        recipe_(recipe),
        psf_(*MakePsf(scene.psf(), BenchScene::kRatio)),
        extent_(Extent(scene)),
        buffer_(extent_),
        update_(Blur(psf_), Options(recipe)),
        regularisation_(psf_, StructurePriorKind::kHuberTv, BenchScene::kRatio) {
    buffer_.scene = buffer_.previous = Start(scene);
  }

  Outcome Run() {
    KeptFrames kept(recipe_.huber_sigmas, 1);
    for (std::size_t t = 0; t < recipe_.views.size(); ++t) {
      const Observation observation = ObservationOf(t);
      regularisation_.Learn(observation, recipe_.views[t]);
      update_.Predict(extent_, &buffer_);
      update_.AddFrame(observation, recipe_.views[t], extent_, &buffer_);
      update_.UpdateSeen(extent_, BenchScene::kRatio, &buffer_);
      const StructureWeight weight = SetWeight();
      update_.Iterate(extent_, t == 0 ? kFirstIterations : kIterations, weight.lambda, &buffer_);
      regularisation_.MakeProbe(extent_, buffer_, scene_.options.noise_sigma);
      kept.Add({static_cast<int>(t), scene_.sequence.roi, observation.noise_sigma, *observation.roi_pixels, {}, recipe_.views[t]}, extent_,
               1.0, buffer_);
    }
    if (recipe_.anew) {
      Accumulated sums = kept.Accumulate(buffer_, 0);
      buffer_.weight = std::move(sums.weight);
      buffer_.weighted = std::move(sums.weighted);
      update_.UpdateSeen(extent_, BenchScene::kRatio, &buffer_);
    }
    StructureWeight weight = SetWeight();
    if (recipe_.fixed) {
      weight = *recipe_.fixed;
      update_.set_prior({StructurePriorKind::kHuberTv, weight.delta});
    }
    update_.Converge(extent_, recipe_.last_iterations, weight.lambda, &buffer_);
    return {Score(scene_, Cut(scene_, InEmittedBand(buffer_.scene))), weight};
  }

 private:
  static InformationOptions Options(const Recipe& recipe) {
    InformationOptions options;
    options.huber_sigmas = recipe.huber_sigmas;
    return options;
  }

  Observation ObservationOf(std::size_t t) const {
    return {&scene_.sequence.frames[t].pixels, scene_.sequence.roi, scene_.options.noise_sigma};
  }

  StructureWeight SetWeight() {
    const StructureWeight weight = regularisation_.Weight(extent_, buffer_, scene_.options.noise_sigma);
    update_.set_prior({StructurePriorKind::kHuberTv, weight.delta});
    return weight;
  }

  const BenchScene& scene_;
  const Recipe& recipe_;
  SeparablePsf psf_;
  Roi extent_;
  SceneBuffer buffer_;
  InformationUpdate update_;
  AutomaticRegularisation regularisation_;
};

// The batch scene with given views and weight.
double Batch(const BenchScene& scene, const std::vector<View>& views, double lambda, double delta, Image<float>* last) {
  std::vector<testing::BatchFrame> frames;
  for (std::size_t t = 0; t < views.size(); ++t) {
    frames.push_back({{&scene.sequence.frames[t].pixels, scene.sequence.roi, scene.options.noise_sigma}, views[t]});
  }
  testing::BatchMapOptions options;
  options.weight = lambda;
  options.prior.delta = static_cast<float>(delta);
  options.tolerance = 0.02;
  if (last->empty()) *last = Start(scene);
  *last = testing::BatchMap(*MakePsf(scene.psf(), BenchScene::kRatio), Extent(scene), frames, options, std::move(*last));
  return Score(scene, Cut(scene, InEmittedBand(*last)));
}

void Print(const std::string& name, double db) {
  fmt::print("  {:<70} {:6.2f}\n", name, db);
  std::fflush(stdout);
}

StructureWeight PrintRecursion(const BenchScene& scene, const std::string& name, const Recipe& recipe) {
  const Outcome outcome = Recursion(scene, recipe).Run();
  Print(fmt::format("{} [lambda {:.4f} delta {:.2f}]", name, outcome.weight.lambda, outcome.weight.delta), outcome.db);
  return outcome.weight;
}

Status RunScene(const BenchScene& scene, bool batch) {
  fmt::print("{}, seed {}\n", scene.name, scene.options.seed);
  TREM_ASSIGN_OR_RETURN(const EngineAnswer engine, RunEngine(scene, EngineOptions{}));
  Print("engine", Score(scene, engine.answer));
  Recipe recipe;
  recipe.views = engine.views;
  PrintRecursion(scene, "recursion, the engine's views", recipe);
  recipe.views = TrueViews(scene);
  const StructureWeight automatic = PrintRecursion(scene, "recursion, true views", recipe);
  recipe.last_iterations = kManyIterations;
  PrintRecursion(scene, fmt::format("  and {} iterations at the end", kManyIterations), recipe);
  recipe.huber_sigmas = 1e6;
  PrintRecursion(scene, "  and no robust weights", recipe);
  recipe.huber_sigmas = Recipe{}.huber_sigmas;
  recipe.anew = true;
  PrintRecursion(scene, "  or the samples accumulated anew", recipe);
  Outcome best;
  for (float factor = 0.25F; factor < 10.0F; factor *= std::sqrt(2.0F)) {
    recipe.fixed = StructureWeight{factor * automatic.lambda, automatic.delta};
    const Outcome outcome = Recursion(scene, recipe).Run();
    if (outcome.db > best.db) best = outcome;
  }
  Print(fmt::format("    and the best weight [lambda {:.4f}]", best.weight.lambda), best.db);
  if (!batch) return {};
  Image<float> last;
  Print("batch, true views, that weight", Batch(scene, recipe.views, best.weight.lambda, best.weight.delta, &last));
  Print("batch, the engine's views, that weight", Batch(scene, engine.views, best.weight.lambda, best.weight.delta, &last));
  const TunedAnswer tuned = TunedMap(scene, scene.options.frame_count);
  Print(fmt::format("batch, true views, weight tuned to the truth [lambda {:.4f} delta 4]", tuned.setting), tuned.db);
  return {};
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  trem::bench::SceneSettings settings;
  int seeds = 1;
  bool batch = false;
  CLI::App app("Where the engine's distance to the batch scene comes from");
  settings.Declare(&app);
  app.add_option("--frames", settings.frames, "Frames")->check(CLI::Range(2, 1000));
  app.add_option("--seeds", seeds, "Repetitions with other noise, motion and procedural ground")->check(CLI::Range(1, 100));
  app.add_flag("--batch", batch, "Batch scenes, too (a minute each)");
  CLI11_PARSE(app, argc, argv);
  for (int seed = 1; seed <= seeds; ++seed) {
    const trem::Status status = trem::bench::ForEachScene(
        settings, seed, [&](const trem::bench::BenchScene& scene) { return trem::bench::RunScene(scene, batch); });
    if (status.ok()) continue;
    std::fprintf(stderr, "%s\n", status.ToString().c_str());
    return 1;
  }
  return 0;
}
