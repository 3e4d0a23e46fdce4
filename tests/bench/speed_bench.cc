// Question: what does a frame cost, beside what others need for part of the work, and beside the machine's limit?
// Peers in the same run, called in turn with the engine frame by frame, so that both see the same noise of the machine; medians:
//   - ONE cv::findTransformECC call on the same ROI, which only registers, to the previous frame: affine, from the motion that the engine
//     is told, OpenCV's default smoothing, eps 1e-3, at most 50 iterations; beside it one that runs until it has converged (eps 1e-6).
//     Both with their error against the truth, and the engine's;
//   - one frame of cv::superres BTV-L1 (its defaults at scale 3: 9 frames, 180 iterations);
//   - the machine: a memcpy of the bytes that a frame must move, and the roofline (tests/bench/roofline.h), which is the larger of that
//     time and of the arithmetic at the peak of one core.
// A frame of the engine is registration and scene update with K iterations, robust terms on, everything else by default; the scene has
// settled (frame kFirstTimed on). OpenCV runs on one thread, as the engine does unless a row says otherwise.
//
// Work of a frame, counted as in update_speed.cc: of the update, 16 planes of 4 bytes a cell under the ROI and the PSF's reach, and the
// operations given there; of the registration, two planes more (prediction and count of frames) and two passes over the ROI's pixels of
// 210 operations (value and slopes of the bicubic 120, normal equations 90).
//
// usage: speed_bench [--frames N]; see --help
#include <fmt/format.h>
#include <hwy/highway.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "tests/bench/peers/bench_scene.h"
#include "tests/bench/peers/ecc.h"
#include "tests/bench/roofline.h"
#include "worker/simulate/truth.h"
#include "worker/tre/segment.h"
#ifdef TREM_BENCH_SUPERRES
#include "tests/bench/peers/btv_l1.h"
#endif

namespace trem::bench {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kFirstTimed = 5;
constexpr int kRatio = 3;
constexpr int kIterations = 2;

double MillisecondsSince(Clock::time_point start) { return 1e3 * std::chrono::duration<double>(Clock::now() - start).count(); }

double Median(std::vector<double> values) {
  TREM_CHECK(!values.empty());
  auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Sequence {
  Roi roi;
  testing::SequenceOptions options;
  std::vector<FrameInput> frames;
  std::vector<Affine> truth_from_sensor;

  Affine PreviousFromCurrent(std::size_t t) const { return truth_from_sensor[t - 1].Inverse() * truth_from_sensor[t]; }
  Affine SceneFromSensor(std::size_t t) const {
    Affine scene_from_sensor;
    scene_from_sensor.linear *= kRatio;
    return scene_from_sensor * truth_from_sensor[0].Inverse() * truth_from_sensor[t];
  }
};

// Frames of width x height px of a dwelling camera over procedural ground.
Sequence MakeSequence(int width, int height, int frame_count) {
  Sequence s;
  s.roi = {0, 0, width, height};
  s.options.motion = testing::CameraMotion::kDwell;
  s.options.frame_count = frame_count;
  s.options.roi_px = std::max(width, height);
  s.options.speed_px = 0.04;
  s.options.psf_sigma_px = 0.6;
  constexpr int kBoards = 4;
  testing::RenderedSequence rendered = testing::RenderSequence(
      ProceduralTerrain(testing::TruthWidth(s.options), testing::TruthHeight(s.options), s.options.seed, kBoards), s.options);
  for (FrameInput& frame : rendered.frames) {
    Image<float> cut(width, height);
    for (int y = 0; y < height; ++y) std::copy_n(frame.pixels.row(y), width, cut.row(y));
    frame.pixels = std::move(cut);
  }
  s.frames = std::move(rendered.frames);
  s.truth_from_sensor = std::move(rendered.truth_from_sensor);
  return s;
}

struct Times {
  double registration_ms = 0.0;
  double update_ms = 0.0;
  double frame_ms = 0.0;
  double ecc_ms = 0.0;  // Converged. 0: not asked for.
  double hasty_ms = 0.0;
  double error_px = 0.0;  // At the worst ROI corner: the engine in frame 0's gauge, the others from frame to frame.
  double ecc_error_px = 0.0;
  double hasty_error_px = 0.0;
  double memcpy_ms = 0.0;  // Of the bytes that a frame must move.
  double floor_ms = 0.0;   // Roofline.
};

Work WorkOf(const Sequence& s, const EngineOptions& options) {
  const double radius = MakePsf(options.psf, kRatio)->radius();
  const double margin = 2.0 * (radius + 3.0);
  const double pixels = static_cast<double>(s.roi.area());
  const double cells = (kRatio * s.roi.width() + margin) * (kRatio * s.roi.height() + margin);
  const double blur = 2.0 * (3.0 * radius + 1.0);
  const double splat = 104.0 * pixels + 2.0 * cells;
  const double seen = cells * (blur + 2.0 * (3.0 * kRatio - 2.0) + 4.0 * (kRatio / 2) + 2.0);
  const double iterate = cells * (kIterations * (2.0 * blur + 17.0) + blur);
  const double registration = 2.0 * 210.0 * pixels;
  return {splat + seen + iterate + registration, 4.0 * ((16.0 + 2.0) * cells + 2.0 * pixels)};
}

// What every timed frame adds; medians at the end.
struct Samples {
  std::vector<double> registration, update, frame, error, ecc, ecc_error, hasty, hasty_error;

  Times Medians() const {
    Times t{Median(registration), Median(update), Median(frame)};
    t.error_px = Median(error);
    if (ecc.empty()) return t;
    t.ecc_ms = Median(ecc);
    t.hasty_ms = Median(hasty);
    t.ecc_error_px = Median(ecc_error);
    t.hasty_error_px = Median(hasty_error);
    return t;
  }
};

void TimeEcc(const Sequence& s, std::size_t t, Samples* samples) {
  const EccAnswer converged = RegisterEcc(s.frames[t - 1], s.frames[t], kConvergedEcc);
  const EccAnswer hasty = RegisterEcc(s.frames[t - 1], s.frames[t], kHastyEcc);
  samples->ecc.push_back(1e3 * converged.seconds);
  samples->hasty.push_back(1e3 * hasty.seconds);
  samples->ecc_error.push_back(LargestCornerMotion(converged.previous_from_current, s.PreviousFromCurrent(t), s.roi));
  samples->hasty_error.push_back(LargestCornerMotion(hasty.previous_from_current, s.PreviousFromCurrent(t), s.roi));
}

Times TimeFrames(const Sequence& s, const EngineOptions& options, bool with_ecc) {
  Segment segment(s.roi, *MakePsf(options.psf, options.ratio), options, 0);
  segment.Begin(s.frames[0], options.noise_sigma);
  Samples samples;
  const Work work = WorkOf(s, options);
  for (std::size_t t = 1; t < s.frames.size(); ++t) {
    const auto start = Clock::now();
    const JudgedRegistration judged = segment.RegisterFrame(s.frames[t], options.noise_sigma);
    const double registration_ms = MillisecondsSince(start);
    TREM_CHECK_MSG(judged.doubt.empty(), judged.doubt);
    const Status added =
        segment.AddFrame(s.frames[t], judged.registration, options.noise_sigma, [](const SceneSnapshot&) { return Status{}; });
    const double frame_ms = MillisecondsSince(start);
    TREM_CHECK(added.ok());
    if (t < kFirstTimed) continue;
    samples.registration.push_back(registration_ms);
    samples.update.push_back(frame_ms - registration_ms);
    samples.frame.push_back(frame_ms);
    samples.error.push_back(LargestCornerMotion(judged.registration.view.scene_from_sensor, s.SceneFromSensor(t), s.roi));
    if (with_ecc) TimeEcc(s, t, &samples);
  }
  Times times = samples.Medians();
  times.memcpy_ms = 1e3 * work.bytes / CopyBytesPerSecond(static_cast<std::size_t>(work.bytes));
  times.floor_ms = std::max(times.memcpy_ms, 1e3 * work.flops / PeakFlopsPerSecond());
  return times;
}

EngineOptions EngineOf(const Sequence& s) {
  EngineOptions options;
  options.psf = {s.options.psf_sigma_px, s.options.fill_factor};
  options.ratio = kRatio;
  options.iterations = kIterations;
  return options;
}

void PrintTimes(const Sequence& s, const EngineOptions& options, const Times& t) {
  const Work work = WorkOf(s, options);
  fmt::print(
      "{:>3} x {:<3}  frame {:8.3f} ms ({:7.1f} frames/s): registration {:8.3f} ms, update {:8.3f} ms; {:6.1f} MFLOP, {:6.2f} MB: "
      "memcpy {:6.3f} ms, roofline {:6.3f} ms\n",
      s.roi.width(), s.roi.height(), t.frame_ms, 1e3 / t.frame_ms, t.registration_ms, t.update_ms, work.flops / 1e6, work.bytes / 1e6,
      t.memcpy_ms, t.floor_ms);
}

void PrintEcc(const Sequence& s, const Times& t) {
  fmt::print(
      "{:>3} x {:<3}  one findTransformECC call: eps 1e-6 {:7.3f} ms, error {:.4f} px; eps 1e-3 {:7.3f} ms, {:.4f} px; the engine's {:.4f} "
      "px\n",
      s.roi.width(), s.roi.height(), t.ecc_ms, t.ecc_error_px, t.hasty_ms, t.hasty_error_px, t.error_px);
}

void PrintPromise(const std::string& what, double ratio, const char* form, double at_least, double aim, bool lower_is_better) {
  const auto met = [&](double bound) { return lower_is_better ? ratio <= bound : ratio >= bound; };
  const std::string seen = fmt::format(fmt::runtime(form), ratio);
  fmt::print("{:<62} {:>9}  promised {} {}: {:<7}  aim {}: {}\n", what, seen, lower_is_better ? "<=" : ">=", at_least,
             met(at_least) ? "met" : "NOT MET", aim, met(aim) ? "met" : "not met");
}

std::string CpuName() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  }
  return "unknown processor";
}

void PrintHeader() {
  const std::int64_t targets = hwy::SupportedTargets();
  fmt::print("{}; widest SIMD target of Highway: {}; OpenCV {} on one thread\n", CpuName(), hwy::TargetName(targets & -targets),
             CV_VERSION);
  fmt::print("3:1, K = {}, robust terms on; medians over the frames\n", kIterations);
}

#ifdef TREM_BENCH_SUPERRES
double SuperresMs() {
  testing::SequenceOptions options;
  options.motion = testing::CameraMotion::kDwell;
  options.frame_count = 9;
  options.roi_px = 151;
  options.speed_px = 0.04;
  options.psf_sigma_px = 0.6;
  const BenchScene scene =
      MakeBenchScene("", false, ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), 1), options);
  return 1e3 * RunBtv(scene, BtvSettings{}).seconds;
}
#endif

void PrintThreads(const Sequence& roi, const Sequence& sensor) {
  for (const Sequence* s : {&roi, &sensor}) {
    EngineOptions two = EngineOf(*s);
    two.threads = 2;
    const double one_ms = TimeFrames(*s, EngineOf(*s), false).frame_ms;
    const double two_ms = TimeFrames(*s, two, false).frame_ms;
    PrintPromise(fmt::format("{} x {}: one thread over two ({:.2f} ms)", s->roi.width(), s->roi.height(), two_ms), one_ms / two_ms,
                 "{:.2f}x", 1.7, 1.9, false);
  }
}

int Run(int frames) {
  cv::setNumThreads(1);
  PrintHeader();
  const Sequence target = MakeSequence(41, 71, 2 * frames);
  const Times on_target = TimeFrames(target, EngineOf(target), true);
  PrintTimes(target, EngineOf(target), on_target);
  const Sequence roi = MakeSequence(151, 151, frames);
  const Times on_roi = TimeFrames(roi, EngineOf(roi), true);
  PrintTimes(roi, EngineOf(roi), on_roi);
  const Sequence sensor = MakeSequence(640, 512, std::max(kFirstTimed + 3, frames / 4));
  const Times on_sensor = TimeFrames(sensor, EngineOf(sensor), false);
  PrintTimes(sensor, EngineOf(sensor), on_sensor);
  PrintEcc(target, on_target);
  PrintEcc(roi, on_roi);
  fmt::print("\n");
  PrintPromise("151 x 151: frame over one findTransformECC call, eps 1e-3", on_roi.frame_ms / on_roi.hasty_ms, "{:.2f}x", 0.6, 0.35, true);
  fmt::print("151 x 151: frame over a converged one, eps 1e-6 {:.2f}x\n", on_roi.frame_ms / on_roi.ecc_ms);
#ifdef TREM_BENCH_SUPERRES
  const double superres_ms = SuperresMs();
  PrintPromise(fmt::format("151 x 151: one superres frame ({:.0f} ms) over a frame", superres_ms), superres_ms / on_roi.frame_ms, "{:.0f}x",
               1000, 2500, false);
#endif
  PrintPromise("151 x 151: part of the roofline", 100.0 * on_roi.floor_ms / on_roi.frame_ms, "{:.1f} %", 35, 60, false);
  PrintPromise("640 x 512: frame over memcpy", on_sensor.frame_ms / on_sensor.memcpy_ms, "{:.2f}x", 4, 2, true);
  fmt::print("640 x 512: update alone over memcpy {:.2f}x\n", on_sensor.update_ms / on_sensor.memcpy_ms);
  PrintThreads(roi, sensor);
  return 0;
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  int frames = 60;
  CLI::App app("Time of a frame beside peers and the machine's limit");
  app.add_option("--frames", frames, "Frames of the 151 x 151 row")->check(CLI::Range(10, 10000));
  CLI11_PARSE(app, argc, argv);
  return trem::bench::Run(frames);
}
