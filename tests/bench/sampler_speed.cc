// Question: how much faster is HINTS than the pairwise search of the method's first year, at like accuracy, in four dimensions? (The paper
// claims more than ten times.) Baseline: the pairwise search on all pixels, with 3 x 3 and with 5 x 5 grids, sharing HINTS's vectorised
// evaluation of pixels, so that the ratio is one of methods. All methods start from the same views and see the same frames; gain and offset
// are fitted at each evaluation by both.
//
// "tree" is HINTS by itself: three levels of nested subsets of about 1024 pixels, random walk proposals whose shape is (J'J)^-1 at the
// start, the mean of the draws. "engine" is what the engine runs: such a tree to come near at falling resolution, then draws from all
// pixels about one Gauss-Newton step.
//
// The reference is the scene that the engine's update makes of 40 noisy frames (--settle). Times are CPU times of the thread.
//
// usage: sampler_speed [TRUTH_IMAGE] [options]; see --help
#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cstdio>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/bench/registration_scene.h"
#include "worker/registration/hints_registration.h"
#include "worker/registration/pairwise.h"
#include "worker/registration/view_target.h"

namespace trem::bench {
namespace {

struct Settings {
  SceneOptions scene;
  int trials = 40;
  int seeds = 2;
  double start_px = 1.5;  // Standard deviation of each of the four parameters of the true view about the start.
};

struct Run {
  View view;
  std::int64_t pixel_evaluations = 0;
};

struct Trial {
  const Observation& observation;
  const Reference& reference;
  const ViewPrior& prior;
  const ViewChart& chart;
  std::uint64_t number = 0;
};

struct Method {
  std::string name;
  std::function<Run(const Trial&)> run;
  std::vector<double> errors;
  std::vector<double> times;
  double evaluations = 0.0;
};

Run Pairwise(const Trial& trial, int grid_half, double last_step_px) {
  PairwiseOptions options;
  options.grid_half = grid_half;
  options.last_step_px = last_step_px;
  Run run;
  run.view = RegisterPairwise(trial.observation, trial.reference, trial.prior, trial.chart, options, &run.pixel_evaluations).view;
  return run;
}

Run Engine(const Trial& trial, int travel_sweeps, int draws, GainOffset gain_offset) {
  HintsSettings settings;
  settings.chart = &trial.chart;
  settings.travel_sweeps = travel_sweeps;
  settings.draws = draws;
  settings.gain_offset = gain_offset;
  HintsCost cost;
  const std::uint64_t stream[3] = {1, 2, trial.number};
  Run run;
  run.view = RegisterHints(trial.observation, trial.reference, trial.prior, HintsUse::kFull, stream, settings, &cost).view;
  // The Gauss-Newton step evaluates all pixels three times at most, the summary once.
  run.pixel_evaluations = cost.pixel_evaluations + 4 * trial.observation.roi.area();
  return run;
}

Run Tree(const Trial& trial, int terms_about, int burn_in, int sweeps) {
  PixelTerms terms(trial.observation, trial.reference, 0, terms_about);
  const ViewTarget target(&terms, trial.prior, trial.chart, Photometry::kProfiled, trial.observation.noise_sigma);
  const Registration laplace = EvaluateView(trial.observation, trial.reference, trial.prior, trial.prior.mean);
  const HintsMatrix information = HintsMatrix(laplace.corner_covariance).inverse();
  const HintsMatrix covariance = (trial.chart.basis.transpose() * information * trial.chart.basis).inverse();
  HintsOptions options;
  options.seed_key = {1, 2, trial.number};
  options.burn_in = burn_in;
  options.sweeps = sweeps;
  options.step = 1.0;
  const double thinning = static_cast<double>(trial.observation.roi.area()) / terms.count();
  const HintsMatrix shape = std::sqrt(thinning) * HintsMatrix(covariance.llt().matrixL());
  const Result<HintsResult> result = RunHints(target, HintsState::Zero(4), shape, options);
  Run run;
  run.view = result.ok() ? target.ViewAt(result->mean) : trial.prior.mean;
  run.pixel_evaluations = result.ok() ? result->term_evaluations : 0;
  return run;
}

std::vector<Method> Methods() {
  using T = const Trial&;
  std::vector<Method> methods;
  const auto add = [&](std::string name, std::function<Run(T)> run) { methods.push_back({std::move(name), std::move(run), {}, {}, 0.0}); };
  add("PAIRWISE 3x3, to 1/16 px", [](T t) { return Pairwise(t, 1, 1.0 / 16); });
  add("PAIRWISE 3x3, to 1/64 px", [](T t) { return Pairwise(t, 1, 1.0 / 64); });
  add("PAIRWISE 3x3, to 1/256 px", [](T t) { return Pairwise(t, 1, 1.0 / 256); });
  add("PAIRWISE 5x5, to 1/16 px", [](T t) { return Pairwise(t, 2, 1.0 / 16); });
  add("PAIRWISE 5x5, to 1/64 px", [](T t) { return Pairwise(t, 2, 1.0 / 64); });
  using Counts = std::vector<std::pair<int, int>>;
  for (const auto& [burn_in, sweeps] : Counts{{10, 5}, {20, 20}, {40, 40}, {80, 80}}) {
    add("HINTS tree 1024 px, " + std::to_string(burn_in) + " + " + std::to_string(sweeps) + " sweeps",
        [b = burn_in, s = sweeps](T t) { return Tree(t, 1024, b, s); });
  }
  for (const auto& [burn_in, sweeps] : Counts{{20, 20}, {40, 40}}) {
    add("HINTS tree all px, " + std::to_string(burn_in) + " + " + std::to_string(sweeps) + " sweeps",
        [b = burn_in, s = sweeps](T t) { return Tree(t, 0, b, s); });
  }
  for (const auto& [travel, draws] : Counts{{4, 4}, {6, 8}, {8, 16}, {12, 48}}) {
    add("HINTS engine, " + std::to_string(travel) + " sweeps a level, " + std::to_string(draws) + " draws",
        [t0 = travel, d = draws](T t) { return Engine(t, t0, d, GainOffset::kMaximumLikelihood); });
  }
  add("HINTS engine, 6 sweeps a level, 8 draws, marginalised", [](T t) { return Engine(t, 6, 8, GainOffset::kMarginalised); });
  return methods;
}

void RunTrials(const Settings& settings, std::uint64_t seed, std::vector<Method>* methods) {
  SceneOptions options = settings.scene;
  options.seed = seed;
  const RegistrationScene scene(options);
  const View nominal = scene.Nominal();
  const RegistrationScene::Window window = scene.WindowAround(nominal, 16.0);
  const Reference reference = window.reference();
  const ViewPrior prior = scene.PriorAbout(nominal, 4.0);
  const ViewChart chart = SimilarityChart(prior, scene.roi());
  Rng rng({seed, 41});
  for (int k = 0; k < settings.trials; ++k) {
    HintsState x(4);
    for (double& element : x) element = settings.start_px * rng.Normal();
    const Frame frame = scene.Render(chart.basis * x, static_cast<std::uint64_t>(k));
    const Observation observation = scene.Observe(frame);
    const Trial trial{observation, reference, prior, chart, static_cast<std::uint64_t>(k)};
    for (Method& method : *methods) {
      const double start = CpuMs();
      const Run run = method.run(trial);
      method.times.push_back(CpuMs() - start);
      method.errors.push_back(ErrorPx(run.view, frame.truth, scene.roi()));
      method.evaluations += static_cast<double>(run.pixel_evaluations);
    }
  }
}

int Main(const Settings& settings) {
  std::vector<Method> methods = Methods();
  for (int seed = 1; seed <= settings.seeds; ++seed) RunTrials(settings, static_cast<std::uint64_t>(seed), &methods);
  std::printf("%d x %d px, four dimensions, %d trials, noise %.1f, starts %.1f px rms off in each\n", settings.scene.width,
              settings.scene.height, settings.trials * settings.seeds, settings.scene.noise_sigma, settings.start_px);
  std::printf("%-56s %9s %9s %14s %9s\n", "method", "median px", "p95 px", "px evaluations", "CPU ms");
  for (const Method& m : methods) {
    std::printf("%-56s %9.4f %9.4f %14.0f %9.2f\n", m.name.c_str(), Quantile(m.errors, 0.5), Quantile(m.errors, 0.95),
                m.evaluations / static_cast<double>(m.times.size()), Quantile(m.times, 0.5));
  }
  // Each pairwise search against the cheapest HINTS that is at least as accurate in the median.
  for (const Method& pairwise : methods) {
    if (pairwise.name.rfind("PAIRWISE", 0) != 0) continue;
    for (const std::string kind : {"HINTS tree", "HINTS engine"}) {
      const Method* best = nullptr;
      for (const Method& m : methods) {
        if (m.name.rfind(kind, 0) != 0 || Quantile(m.errors, 0.5) > Quantile(pairwise.errors, 0.5)) continue;
        if (best == nullptr || Quantile(m.times, 0.5) < Quantile(best->times, 0.5)) best = &m;
      }
      if (best == nullptr) {
        std::printf("%s: no %s as accurate\n", pairwise.name.c_str(), kind.c_str());
        continue;
      }
      std::printf("%s: %s takes %.1f times less CPU time, %.1f times fewer pixel evaluations\n", pairwise.name.c_str(), best->name.c_str(),
                  Quantile(pairwise.times, 0.5) / Quantile(best->times, 0.5), pairwise.evaluations / best->evaluations);
    }
  }
  return 0;
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  trem::bench::Settings settings;
  settings.scene.settle_frames = 40;
  CLI::App app("HINTS against the pairwise search at like accuracy, in four dimensions");
  app.add_option("truth", settings.scene.truth, "Picture to look at; default: procedural");
  app.add_option("--width", settings.scene.width, "Of the ROI, sensor pixels");
  app.add_option("--height", settings.scene.height, "Of the ROI, sensor pixels");
  app.add_option("--noise", settings.scene.noise_sigma, "Grey levels");
  app.add_option("--trials", settings.trials, "Frames a seed");
  app.add_option("--seeds", settings.seeds, "Scenes");
  app.add_option("--settle", settings.scene.settle_frames, "Frames that the engine's scene is made of; 0: the blurred truth");
  app.add_option("--start", settings.start_px, "How far the starts are off, rms px of each parameter");
  CLI11_PARSE(app, argc, argv);
  return trem::bench::Main(settings);
}
