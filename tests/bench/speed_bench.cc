// Question: what does a frame cost, beside what others need for part of the work, and beside the machine's limit?
// Peers in the same run, called in turn with the engine frame by frame, so that both see the same noise of the machine; medians:
//   - ONE cv::findTransformECC call on the same ROI (affine, from the motion that the engine is told, at most 50 iterations, eps 1e-3,
//     OpenCV's default smoothing), which only registers: to the previous frame, as OpenCV's users do;
//   - one frame of cv::superres BTV-L1 (its defaults at scale 3: 9 frames, 180 iterations);
//   - memcpy of the bytes that a frame must move.
// A frame of the engine is registration and scene update with K iterations, robust terms on, everything else by default; the scene has
// settled (frame kFirstTimed on). OpenCV runs on one thread, as the engine does unless a row says otherwise.
//
// The bytes that a frame must move, 4 a cell of the scene under the ROI: each iteration reads S, the S before, W and Z and writes S and
// the S before (6 planes); the prediction B S is written once and read once. Registration reads the ROI's pixels and the prediction.
//
// usage: speed_bench [--frames N]; see --help
#include <fmt/format.h>
#include <hwy/highway.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "tests/bench/peers/bench_scene.h"
#include "tests/bench/peers/ecc.h"
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
  return s;
}

struct Times {
  double registration_ms = 0.0;
  double update_ms = 0.0;
  double frame_ms = 0.0;
  double ecc_ms = 0.0;     // 0: not asked for.
  double memcpy_ms = 0.0;  // Of MovedBytes().
};

double MovedBytes(const Sequence& s, int iterations) {
  const double cells = static_cast<double>(s.roi.area()) * kRatio * kRatio;
  return 4.0 * (cells * (6.0 * iterations + 2.0 + 1.0) + static_cast<double>(s.roi.area()));
}

// Of one memcpy that reads and writes `bytes` in all.
double MemcpyMs(double bytes, std::vector<char>* from, std::vector<char>* to) {
  const auto half = static_cast<std::size_t>(bytes / 2.0);
  from->resize(half, 1);
  to->resize(half, 2);
  const auto start = Clock::now();
  std::memcpy(to->data(), from->data(), half);
  return MillisecondsSince(start);
}

Times TimeFrames(const Sequence& s, const EngineOptions& options, bool with_ecc) {
  Segment segment(s.roi, *MakePsf(options.psf, options.ratio), options, 0);
  segment.Begin(s.frames[0], options.noise_sigma);
  std::vector<double> registration, update, frame, ecc, copies;
  std::vector<char> from, to;
  for (std::size_t t = 1; t < s.frames.size(); ++t) {
    const auto start = Clock::now();
    const JudgedRegistration judged = segment.RegisterFrame(s.frames[t], options.noise_sigma);
    const double registration_ms = MillisecondsSince(start);
    TREM_CHECK_MSG(judged.doubt.empty(), judged.doubt);
    const Status added =
        segment.AddFrame(s.frames[t], judged.registration, options.noise_sigma, [](const SceneSnapshot&) { return Status{}; });
    const double frame_ms = MillisecondsSince(start);
    TREM_CHECK(added.ok());
    const double ecc_ms = with_ecc ? 1e3 * RegisterEcc(s.frames[t - 1], s.frames[t]).seconds : 0.0;
    const double copy_ms = MemcpyMs(MovedBytes(s, kIterations), &from, &to);
    if (t < kFirstTimed) continue;
    registration.push_back(registration_ms);
    update.push_back(frame_ms - registration_ms);
    frame.push_back(frame_ms);
    ecc.push_back(ecc_ms);
    copies.push_back(copy_ms);
  }
  return {Median(registration), Median(update), Median(frame), Median(ecc), Median(copies)};
}

EngineOptions EngineOf(const Sequence& s) {
  EngineOptions options;
  options.psf = {s.options.psf_sigma_px, s.options.fill_factor};
  options.ratio = kRatio;
  options.iterations = kIterations;
  return options;
}

void PrintTimes(const Sequence& s, const Times& t) {
  fmt::print(
      "{:>3} x {:<3}  frame {:8.3f} ms ({:7.1f} frames/s): registration {:8.3f} ms, update {:8.3f} ms; memcpy of {:6.2f} MB {:7.3f} ms\n",
      s.roi.width(), s.roi.height(), t.frame_ms, 1e3 / t.frame_ms, t.registration_ms, t.update_ms, MovedBytes(s, kIterations) / 1e6,
      t.memcpy_ms);
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

int Run(int frames) {
  cv::setNumThreads(1);
  PrintHeader();
  const Sequence target = MakeSequence(41, 71, 2 * frames);
  const Times on_target = TimeFrames(target, EngineOf(target), true);
  PrintTimes(target, on_target);
  const Sequence roi = MakeSequence(151, 151, frames);
  const Times on_roi = TimeFrames(roi, EngineOf(roi), true);
  PrintTimes(roi, on_roi);
  const Sequence sensor = MakeSequence(640, 512, std::max(kFirstTimed + 3, frames / 4));
  const Times on_sensor = TimeFrames(sensor, EngineOf(sensor), false);
  PrintTimes(sensor, on_sensor);
  fmt::print("one findTransformECC call: {:.3f} ms at 41 x 71, {:.3f} ms at 151 x 151\n\n", on_target.ecc_ms, on_roi.ecc_ms);
  PrintPromise("151 x 151: frame over one findTransformECC call", on_roi.frame_ms / on_roi.ecc_ms, "{:.2f}x", 0.6, 0.35, true);
#ifdef TREM_BENCH_SUPERRES
  const double superres_ms = SuperresMs();
  PrintPromise(fmt::format("151 x 151: one superres frame ({:.0f} ms) over a frame", superres_ms), superres_ms / on_roi.frame_ms, "{:.0f}x",
               1000, 2500, false);
#endif
  PrintPromise("640 x 512: frame over memcpy", on_sensor.frame_ms / on_sensor.memcpy_ms, "{:.2f}x", 4, 2, true);
  fmt::print("640 x 512: update alone over memcpy {:.2f}x\n", on_sensor.update_ms / on_sensor.memcpy_ms);
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
