// Question: how accurate is each registration method, from how far does it find its way, and what does it cost? Baseline and peers in the
// same run: the pairwise search of the method's first year, and OpenCV's findTransformECC.
//
// Accuracy: frames whose corners are 1 px rms off the prior's mean. Capture: frames displaced by a translation of given length in a random
// direction and a rotation of random sign; a trial succeeds when the largest error of a corner ends below 0.25 px. The scene reaches
// `--margin` px beyond the ROI at the start, as a mapping scene does.
//
// AUTO is what the engine runs by default: Register judges each result and falls back. A trial that AUTO refuses counts as not captured.
//
// usage: registration_peers [TRUTH_IMAGE] [--capture] [options]; see --help
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/bench/registration_scene.h"
#include "worker/registration/hints_registration.h"
#include "worker/registration/pairwise.h"
#include "worker/registration/registration.h"

namespace trem::bench {
namespace {

constexpr double kCapturedPx = 0.25;
constexpr double kPi = 3.14159265358979323846;

struct Settings {
  SceneOptions scene;
  bool capture = false;
  int trials = 30;
  int seeds = 3;
  double margin_px = 24.0;
  std::string only;  // Methods whose name begins with this; empty: all.
};

struct Trial {
  const Observation& observation;
  const Reference& reference;
  const ViewPrior& prior;
  std::uint64_t number = 0;
};

struct Method {
  std::string name;
  std::function<View(const Trial&)> run;
  int every = 1;  // Runs on every n-th trial only.
  std::vector<double> errors;
  std::vector<double> times;
};

View GaussNewton(const Trial& t, const View& start, int pyramid_levels) {
  GaussNewtonOptions options;
  options.pyramid_levels = pyramid_levels;
  return RegisterGaussNewton(t.observation, t.reference, t.prior, start, options).view;
}

View Hints(const Trial& t, HintsUse use, GainOffset gain_offset) {
  const std::uint64_t stream[3] = {1, 2, t.number};
  HintsSettings settings;
  settings.gain_offset = gain_offset;
  return RegisterHints(t.observation, t.reference, t.prior, use, stream, settings).view;
}

View Auto(const Trial& t) {
  RegistrationRequest request;
  request.prior = t.prior;
  request.motion_px_max = 1e3;  // The trials' displacements are not to be doubted.
  request.stream[2] = t.number;
  const JudgedRegistration judged = Register(t.observation, t.reference, request);
  if (judged.doubt.empty()) return judged.registration.view;
  View refused;
  refused.scene_from_sensor.offset.setConstant(std::numeric_limits<double>::infinity());
  return refused;
}

std::vector<Method> Methods(const Settings& s) {
  const bool capture = s.capture;
  using T = const Trial&;
  std::vector<Method> methods;
  const auto add = [&](const char* name, std::function<View(T)> run, int every = 1) {
    if (std::string(name).starts_with(s.only)) methods.push_back({name, std::move(run), every, {}, {}});
  };
  add("AUTO", [](T t) { return Auto(t); });
  add("GAUSS_NEWTON", [](T t) { return GaussNewton(t, t.prior.mean, 0); });
  if (capture) add("pyramid GAUSS_NEWTON", [](T t) { return GaussNewton(t, t.prior.mean, 3); });
  if (!capture) add("HINTS", [](T t) { return Hints(t, HintsUse::kFull, GainOffset::kMaximumLikelihood); });
  if (!capture) add("HINTS, marginalised", [](T t) { return Hints(t, HintsUse::kFull, GainOffset::kMarginalised); });
  add("HINTS_THEN_GAUSS_NEWTON", [](T t) { return GaussNewton(t, Hints(t, HintsUse::kCapture, GainOffset::kMaximumLikelihood), 0); });
  // Slow: a fifth of the capture trials has to do.
  add(
      "PAIRWISE", [](T t) { return RegisterPairwise(t.observation, t.reference, t.prior, FullChart(t.prior, t.observation.roi), {}).view; },
      capture ? 5 : 1);
  add("OpenCV findTransformECC", [](T t) {
    View view = t.prior.mean;
    RegisterEcc(t.observation, t.reference, t.prior.mean, &view);
    return view;
  });
  return methods;
}

void Measure(const Trial& trial, const View& truth, const Roi& roi, std::vector<Method>* methods) {
  for (Method& method : *methods) {
    if (trial.number % static_cast<std::uint64_t>(method.every) != 0) continue;
    const double start = NowMs();
    const View view = method.run(trial);
    method.times.push_back(NowMs() - start);
    method.errors.push_back(ErrorPx(view, truth, roi));
  }
}

void Accuracy(const Settings& s, SceneOptions options) {
  std::vector<Method> methods = Methods(s);
  for (int seed = 1; seed <= s.seeds; ++seed) {
    options.seed = static_cast<std::uint64_t>(seed);
    const RegistrationScene scene(options);
    const RegistrationScene::Window window = scene.WindowAround(scene.Nominal(), s.margin_px);
    const Reference reference = window.reference();
    const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 3.0);
    Rng rng({options.seed, 43});
    for (int k = 0; k < s.trials; ++k) {
      CornerVector d(6);
      for (double& element : d) element = rng.Normal();
      const Frame frame = scene.Render(d, static_cast<std::uint64_t>(k));
      const Observation observation = scene.Observe(frame);
      Measure({observation, reference, prior, static_cast<std::uint64_t>(k)}, frame.truth, scene.roi(), &methods);
    }
  }
  std::printf("%d x %d px, %s, %d trials, noise %.1f\n%-28s %10s %10s %10s %9s\n", options.width, options.height,
              options.truth.empty() ? "procedural" : options.truth.c_str(), s.trials * s.seeds, options.noise_sigma, "method", "median px",
              "p95 px", "worst px", "ms");
  for (const Method& m : methods) {
    std::printf("%-28s %10.4f %10.4f %10.4f %9.2f\n", m.name.c_str(), Quantile(m.errors, 0.5), Quantile(m.errors, 0.95),
                Quantile(m.errors, 1.0), Quantile(m.times, 0.5));
  }
}

struct Off {
  double shift_px;
  double rotation_deg;
};

void Capture(const Settings& s) {
  constexpr Off kOffs[] = {{4, 0}, {8, 6}, {16, 0}, {16, 12}, {24, 0}, {24, 15}};
  constexpr int kFrames = 5;  // Rendered a seed; each is met from many starts.
  std::vector<std::vector<Method>> table;
  for (std::size_t k = 0; k < std::size(kOffs); ++k) table.push_back(Methods(s));
  for (int seed = 1; seed <= s.seeds; ++seed) {
    SceneOptions options = s.scene;
    options.seed = static_cast<std::uint64_t>(seed);
    const RegistrationScene scene(options);
    Rng rng({options.seed, 47});
    std::vector<Frame> frames;
    for (int k = 0; k < kFrames; ++k) {
      CornerVector d(6);
      for (double& element : d) element = rng.Normal();
      frames.push_back(scene.Render(d, static_cast<std::uint64_t>(k)));
    }
    for (std::size_t cell = 0; cell < table.size(); ++cell) {
      for (int k = 0; k < s.trials; ++k) {
        const Frame& frame = frames[static_cast<std::size_t>(k % kFrames)];
        const double direction = 2.0 * kPi * rng.Uniform();
        const double sign = rng.Uniform() < 0.5 ? -1.0 : 1.0;
        const CornerVector d =
            RigidDisplacement(scene.roi(), kOffs[cell].shift_px * Eigen::Vector2d(std::cos(direction), std::sin(direction)),
                              sign * kOffs[cell].rotation_deg * kPi / 180.0);
        const View start{Displace(frame.truth.scene_from_sensor, scene.roi(), d), 1.0, 0.0};
        const RegistrationScene::Window window = scene.WindowAround(start, s.margin_px);
        const Reference reference = window.reference();
        const Observation observation = scene.Observe(frame);
        const ViewPrior prior = scene.PriorAbout(start, 20.0);
        Measure({observation, reference, prior, static_cast<std::uint64_t>(k)}, frame.truth, scene.roi(), &table[cell]);
      }
    }
  }
  std::printf("capture at %d x %d px, %s: %% of %d trials that end < %.2f px, ms\n%-28s", s.scene.width, s.scene.height,
              s.scene.truth.empty() ? "procedural" : s.scene.truth.c_str(), s.trials * s.seeds, kCapturedPx, "method");
  for (const Off& off : kOffs) std::printf("  %2.0f px %2.0f deg ", off.shift_px, off.rotation_deg);
  std::printf("\n");
  for (std::size_t m = 0; m < table[0].size(); ++m) {
    std::printf("%-28s", table[0][m].name.c_str());
    for (const std::vector<Method>& cell : table) {
      int captured = 0;
      for (const double error : cell[m].errors) captured += error < kCapturedPx ? 1 : 0;
      std::printf(" %5.1f %6.1f ms", 100.0 * captured / static_cast<double>(cell[m].errors.size()), Quantile(cell[m].times, 0.5));
    }
    std::printf("\n");
  }
}

int Main(const Settings& s) {
  if (s.capture) {
    Capture(s);
    return 0;
  }
  Accuracy(s, s.scene);
  SceneOptions small = s.scene;
  small.width = 41;
  small.height = 71;
  Accuracy(s, small);
  return 0;
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  trem::bench::Settings s;
  CLI::App app("Accuracy, capture and cost of the registration methods");
  app.add_option("truth", s.scene.truth, "Picture to look at; default: procedural");
  app.add_flag("--capture", s.capture, "The capture table instead of the accuracy tables");
  app.add_option("--width", s.scene.width, "Of the ROI, sensor pixels");
  app.add_option("--height", s.scene.height, "Of the ROI, sensor pixels");
  app.add_option("--noise", s.scene.noise_sigma, "Grey levels");
  app.add_option("--trials", s.trials, "A seed (and an entry of the capture table)");
  app.add_option("--seeds", s.seeds, "Scenes");
  app.add_option("--settle", s.scene.settle_frames, "Frames that the engine's scene is made of; 0: the blurred truth");
  app.add_option("--only", s.only, "Methods whose name begins with this");
  app.add_option("--margin", s.margin_px, "Scene beyond the ROI at the start, sensor pixels");
  CLI11_PARSE(app, argc, argv);
  return trem::bench::Main(s);
}
