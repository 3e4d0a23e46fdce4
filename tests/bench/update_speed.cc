// Question: how near is the scene update to what the machine can do?
// Baseline, measured in the same run: the peak of one core's fused multiply-adds and a memcpy of the bytes that must move
// (tests/bench/roofline.h). The floor of a stage is the larger of the two times. Both are the best of several trials, so they are compared
// with the stage's fastest run (fastest_ms), not with the mean that a busy machine makes longer.
//
// Work per cell of the scene, r the PSF's radius in cells, q the ratio, K iterations; a plane is 4 bytes a cell, read or written once:
//   splat       5 planes (prediction read, W and Z read and written); 104 FLOP a pixel of the frame, 2 a cell (forgetting)
//   seen        3 planes (W read, majoriser and seen written); B 2 (3 r + 1), tents 2 (3 q - 2), near 2 (2 floor(q / 2)), 2
//   predict     2 planes (S read, B S written); 2 (3 r + 1)
//   iterate K   8 planes (S, S before, W, Z, majoriser read; S, S before, B S written); K (4 (3 r + 1) + 17): two B, 3 extrapolation, 2
//               residual, 12 prior and step, per iteration, the prediction being the first of the next frame's. Reading it then is a
//               ninth plane, which one more B would save: not counted
//   update      splat + seen + iterate
//   fill        1 plane (what has been filled); nothing is computed where every cell has been measured
//   residual    4 planes of pixels (frame, predicted, value, variance) and 2 of cells (prediction and seen); 40 FLOP a pixel
//   weight      a third of 2 planes (S, seen), of 300 rows and more a sixth; 9 FLOP a cell of it
//   normal      2 planes (prediction, seen), 1 of pixels; 210 FLOP a pixel: one evaluation of Gauss-Newton's equations with all pixels
// Minima and maxima, address arithmetic and what tiles recompute of their neighbours are not counted.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <string>

#include "mosaic/base/rng.h"
#include "tests/bench/cpu_clock.h"
#include "tests/bench/roofline.h"
#include "worker/registration/normal_equations.h"
#include "worker/tre/automatic_regularisation.h"
#include "worker/tre/fill_unseen.h"
#include "worker/tre/frame_residual.h"
#include "worker/tre/information_update.h"

namespace trem {
namespace {

constexpr int kRatio = 3;
constexpr float kLambda = 0.02F;

struct Size {
  int width;
  int height;
};
constexpr Size kSizes[] = {{41, 71}, {151, 151}, {640, 512}};

struct Fixture {
  Roi roi;
  SeparablePsf psf = *MakePsf({0.55, 0.9}, kRatio);
  Roi region;
  View view;
  Image<float> frame;
  int threads;
  InformationUpdate update;
  SceneBuffer buffer;
  FrameInput input;
  Image<float> continued;
  FrameResidual residual;
  AutomaticRegularisation regularisation;

  Fixture(const Size& size, int thread_count)
      : roi{0, 0, size.width, size.height},
        region{-Margin(), -Margin(), kRatio * size.width + Margin(), kRatio * size.height + Margin()},
        frame(size.width, size.height),
        threads(thread_count),
        update(Blur(psf), Options(thread_count)),
        buffer(region),
        regularisation(psf, StructurePriorKind::kHuberTv, kRatio) {
    Rng rng({1});
    for (float& p : frame.pixels()) p = static_cast<float>(100.0 + 20.0 * rng.Normal());
    for (float& s : buffer.scene.pixels()) s = static_cast<float>(100.0 + 5.0 * rng.Normal());
    buffer.previous = buffer.scene;
    view.scene_from_sensor.linear << 3.0, 0.02, -0.02, 3.0;
    view.scene_from_sensor.offset = {0.4, 4.3};
    update.Predict(region, &buffer);
    input.pixels = frame;
    Fill();
    Splat();
    Seen();
  }

  int Margin() const { return psf.radius() + 3; }
  static InformationOptions Options(int threads) {
    InformationOptions options;
    options.forgetting = 0.985;
    options.threads = threads;
    return options;
  }
  void Splat() { update.AddFrame({&frame, roi, 2.0}, view, region, &buffer); }
  void Seen() { update.UpdateSeen(region, kRatio, &buffer); }
  void Predict() { update.Predict(region, &buffer); }
  void Fill() { FillUnseen(input, roi, view, region, &buffer, &continued); }
  void Residual() { residual.Compute({&frame, roi, 2.0}, view, buffer, threads); }
  void Weight() { benchmark::DoNotOptimize(regularisation.Weight(region, buffer, 2.0)); }
  void Normal() {
    const Reference reference{&buffer.prediction, &buffer.seen, buffer.extent.x0, buffer.extent.y0, kRatio, 0.75F};
    const RegistrationLevel level{&frame, nullptr, &buffer.prediction, &buffer.seen, 1.0, 1.0, 1, threads};
    benchmark::DoNotOptimize(AccumulateNormal(level, roi, reference, view, ViewModel::kAffine, 2.0, 3.0, nullptr));
  }
  void Iterate(int iterations) { update.Iterate(region, iterations, kLambda, &buffer); }

  double cells() const { return static_cast<double>(region.area()); }
  double blur_flops() const { return 2.0 * (3.0 * psf.radius() + 1.0); }
  bench::Work SplatWork() const { return {104.0 * static_cast<double>(roi.area()) + 2.0 * cells(), 5 * 4 * cells()}; }
  bench::Work SeenWork() const {
    return {cells() * (blur_flops() + 2.0 * (3.0 * kRatio - 2.0) + 4.0 * (kRatio / 2) + 2.0), 3 * 4 * cells()};
  }
  bench::Work PredictWork() const { return {cells() * blur_flops(), 2 * 4 * cells()}; }
  double pixels() const { return static_cast<double>(roi.area()); }
  bench::Work FillWork() const { return {0.0, 4 * cells()}; }
  bench::Work ResidualWork() const { return {40.0 * pixels(), 4 * (4 * pixels() + 2 * cells())}; }
  bench::Work WeightWork() const {
    const double looked_at = cells() / (region.height() < 300 ? 3 : 6);
    return {9.0 * looked_at, 4 * 2 * looked_at};
  }
  bench::Work NormalWork() const { return {210.0 * pixels(), 4 * (pixels() + 2 * cells())}; }
  bench::Work IterateWork(int iterations) const { return {cells() * iterations * (2.0 * blur_flops() + 17.0), 8 * 4 * cells()}; }
};

using Stage = void (*)(Fixture*);
using StageWork = bench::Work (*)(const Fixture&);

void RunStage(benchmark::State& state, const Size& size, int threads, Stage stage, StageWork work) {
  Fixture fixture(size, threads);
  stage(&fixture);
  // CPU time of the one thread; wall-clock time of several.
  const auto now = [threads] {
    return threads == 1 ? bench::ThreadCpuMs()
                        : 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  };
  double fastest = 1e9;
  for (auto _ : state) {
    const double start = now();
    stage(&fixture);
    fastest = std::min(fastest, 1e-3 * (now() - start));
  }
  state.counters["fastest_ms"] = 1e3 * fastest;
  bench::Judge(state, work(fixture), fastest);
}

bench::Work Sum(std::initializer_list<bench::Work> parts) {
  bench::Work sum;
  for (const bench::Work& part : parts) {
    sum.flops += part.flops;
    sum.bytes += part.bytes;
  }
  return sum;
}

void Register(const std::string& name, const Size& size, int threads, Stage stage, StageWork work) {
  const std::string full = name + "/" + std::to_string(size.width) + "x" + std::to_string(size.height) +
                           (threads > 1 ? "/threads:" + std::to_string(threads) : std::string());
  benchmark::RegisterBenchmark(full.c_str(), [=](benchmark::State& state) { RunStage(state, size, threads, stage, work); })
      ->Unit(benchmark::kMillisecond)
      ->UseRealTime();
}

void RegisterAll() {
  for (const Size& size : kSizes) {
    Register(
        "splat", size, 1, [](Fixture* f) { f->Splat(); }, [](const Fixture& f) { return f.SplatWork(); });
    Register(
        "seen", size, 1, [](Fixture* f) { f->Seen(); }, [](const Fixture& f) { return f.SeenWork(); });
    Register(
        "predict", size, 1, [](Fixture* f) { f->Predict(); }, [](const Fixture& f) { return f.PredictWork(); });
    Register(
        "iterate_K2", size, 1, [](Fixture* f) { f->Iterate(2); }, [](const Fixture& f) { return f.IterateWork(2); });
    Register(
        "iterate_K4", size, 1, [](Fixture* f) { f->Iterate(4); }, [](const Fixture& f) { return f.IterateWork(4); });
    Register(
        "fill", size, 1, [](Fixture* f) { f->Fill(); }, [](const Fixture& f) { return f.FillWork(); });
    Register(
        "residual", size, 1, [](Fixture* f) { f->Residual(); }, [](const Fixture& f) { return f.ResidualWork(); });
    Register(
        "weight", size, 1, [](Fixture* f) { f->Weight(); }, [](const Fixture& f) { return f.WeightWork(); });
    for (const int threads : {1, 2}) {
      Register(
          "normal", size, threads, [](Fixture* f) { f->Normal(); }, [](const Fixture& f) { return f.NormalWork(); });
    }
    for (const int threads : {1, 2}) {
      const Stage update = [](Fixture* f) {
        f->Splat();
        f->Seen();
        f->Iterate(2);
      };
      Register("update_K2", size, threads, update, [](const Fixture& f) { return Sum({f.SplatWork(), f.SeenWork(), f.IterateWork(2)}); });
    }
  }
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::RegisterAll();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
