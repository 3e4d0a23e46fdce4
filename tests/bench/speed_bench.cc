// Question: what does a frame cost, beside what others need for part of the work, and beside the machine's limit?
// Peers in the same run, in turn with the engine, sequence by sequence, so that both see the same noise of the machine and each goes from
// frame to frame as in use, with its own data in the caches. (With the peer's three calls between any two of the engine's frames a frame of
// 151 x 151 takes about a third longer.) The sequence is run several times; what a frame takes is the least of its times, which the
// machine's other work can only make longer, and what is printed is the mean over the frames: some do work that others are spared (probes
// of the structure's weight, new ground). Times are CPU time of the one thread; of one thread beside two, wall-clock times, which need a
// second core that is free.
//   Peers:
//   - ONE cv::findTransformECC call on the same ROI, which only registers, to the previous frame: affine, from the motion that the engine
//     is told, OpenCV's default smoothing, at most 50 iterations, for eps 1e-2, 1e-3 and 1e-6. Each with its error against the truth, and
//     the engine's: the peer at like accuracy is the fastest one whose error is that of the converged one;
//   - one frame of cv::superres BTV-L1 (its defaults at scale 3: 9 frames, 180 iterations);
//   - the machine: a memcpy of the bytes that a frame must move, and the roofline (tests/bench/roofline.h), which is the larger of that
//     time and of the arithmetic at the peak of one core.
// A frame of the engine is registration and scene update with K iterations, robust terms on, everything else by default; the scene has
// settled (kFirstTimed). OpenCV runs on one thread, as the engine does unless a row says otherwise.
//
// Work of a frame, counted as in update_speed.cc: of the update, 16 planes of 4 bytes a cell under the ROI and the PSF's reach, and the
// operations given there; of the registration, two planes more (prediction and count of frames) and two passes over the ROI's pixels of
// 210 operations (value and slopes of the bicubic 120, normal equations 90).
//
// usage: speed_bench [--frames N] [--rows ROW ...]; see --help
#include <fmt/format.h>
#include <hwy/highway.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "tests/bench/cpu_clock.h"
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

// Frames before the scene has settled, which are not timed: the revisit of the first ones is among them.
constexpr int kFirstTimed = 9;
constexpr int kRatio = 3;
constexpr int kIterations = 2;

double WallMs() { return 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double Median(std::vector<double> values) {
  TREM_CHECK(!values.empty());
  auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The times of the frames of a sequence that is run several times: of each the least.
class LeastTimes {
 public:
  void Add(std::size_t frame, double ms) {
    if (frame >= least_.size()) least_.resize(frame + 1, 0.0);
    least_[frame] = least_[frame] > 0.0 ? std::min(least_[frame], ms) : ms;
  }
  // Over the frames that have been timed; 0 without any.
  double Mean() const {
    double sum = 0.0;
    double count = 0.0;
    for (const double ms : least_) {
      sum += ms;
      count += ms > 0.0 ? 1.0 : 0.0;
    }
    return count > 0.0 ? sum / count : 0.0;
  }

 private:
  std::vector<double> least_;
};

enum class Timing { kCpu, kWall };

struct Sequence {
  Roi roi;
  testing::SequenceOptions options;
  std::vector<FrameInput> frames;
  std::vector<Affine> truth_from_sensor;
  std::size_t first_timed = kFirstTimed;
  int runs = 5;

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

constexpr double kEccEps[] = {1e-2, 1e-3, 1e-6};
constexpr std::size_t kEccCount = std::size(kEccEps);

struct Times {
  double registration_ms = 0.0;
  double update_ms = 0.0;
  double frame_ms = 0.0;
  double error_px = 0.0;          // At the worst ROI corner, median: the engine in frame 0's gauge, the others from frame to frame.
  double ecc_ms[kEccCount] = {};  // 0: not asked for.
  double ecc_error_px[kEccCount] = {};
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
  const double iterate = cells * kIterations * (2.0 * blur + 17.0);
  const double registration = 2.0 * 210.0 * pixels;
  return {splat + seen + iterate + registration, 4.0 * ((16.0 + 2.0) * cells + 2.0 * pixels)};
}

// What every timed frame adds.
struct Samples {
  LeastTimes registration, update, frame, ecc[kEccCount];
  std::vector<double> error, ecc_error[kEccCount];

  Times Summary() const {
    Times t{registration.Mean(), update.Mean(), frame.Mean(), Median(error)};
    for (std::size_t k = 0; k < kEccCount && !ecc_error[k].empty(); ++k) {
      t.ecc_ms[k] = ecc[k].Mean();
      t.ecc_error_px[k] = Median(ecc_error[k]);
    }
    return t;
  }
};

void TimeEcc(const Sequence& s, Samples* samples) {
  for (std::size_t k = 0; k < kEccCount; ++k) {
    for (std::size_t t = s.first_timed; t < s.frames.size(); ++t) {
      const EccAnswer answer = RegisterEcc(s.frames[t - 1], s.frames[t], {kEccEps[k]});
      samples->ecc[k].Add(t, 1e3 * answer.seconds);
      samples->ecc_error[k].push_back(LargestCornerMotion(answer.previous_from_current, s.PreviousFromCurrent(t), s.roi));
    }
  }
}

void RunOnce(const Sequence& s, const EngineOptions& options, Timing timing, Samples* samples) {
  const auto now = timing == Timing::kCpu ? ThreadCpuMs : WallMs;
  Segment segment(s.roi, *MakePsf(options.psf, options.ratio), options, 0);
  segment.Begin(s.frames[0], options.noise_sigma);
  for (std::size_t t = 1; t < s.frames.size(); ++t) {
    const double start = now();
    const JudgedRegistration judged = segment.RegisterFrame(s.frames[t], options.noise_sigma);
    const double registration_ms = now() - start;
    TREM_CHECK_MSG(judged.doubt.empty(), judged.doubt);
    const Status added =
        segment.AddFrame(s.frames[t], judged.registration, options.noise_sigma, [](const SceneSnapshot&) { return Status{}; });
    const double frame_ms = now() - start;
    TREM_CHECK(added.ok());
    if (t < s.first_timed) continue;
    samples->registration.Add(t, registration_ms);
    samples->update.Add(t, frame_ms - registration_ms);
    samples->frame.Add(t, frame_ms);
    samples->error.push_back(LargestCornerMotion(judged.registration.view.scene_from_sensor, s.SceneFromSensor(t), s.roi));
  }
}

Times TimeFrames(const Sequence& s, const EngineOptions& options, Timing timing, bool with_ecc) {
  Samples samples;
  for (int run = 0; run < s.runs; ++run) {
    RunOnce(s, options, timing, &samples);
    if (with_ecc) TimeEcc(s, &samples);
  }
  Times times = samples.Summary();
  const Work work = WorkOf(s, options);
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
  fmt::print("{:>3} x {:<3}  one findTransformECC call:", s.roi.width(), s.roi.height());
  for (std::size_t k = 0; k < kEccCount; ++k)
    fmt::print(" eps {:.0e} {:.3f} ms, error {:.4f} px;", kEccEps[k], t.ecc_ms[k], t.ecc_error_px[k]);
  fmt::print(" the engine's {:.4f} px\n", t.error_px);
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
  fmt::print("3:1, K = {}, robust terms on; least time of every frame, mean over the frames\n", kIterations);
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
    const double one_ms = TimeFrames(*s, EngineOf(*s), Timing::kWall, false).frame_ms;
    const double two_ms = TimeFrames(*s, two, Timing::kWall, false).frame_ms;
    PrintPromise(fmt::format("{} x {}: one thread over two ({:.2f} ms)", s->roi.width(), s->roi.height(), two_ms), one_ms / two_ms,
                 "{:.2f}x", 1.7, 1.9, false);
  }
}

// What is measured: parts of the whole run.
const std::vector<std::string> kRows = {"target", "roi", "sensor", "superres", "threads"};

void PrintRoiPromises(const Times& on_roi) {
  for (std::size_t k = 0; k < kEccCount; ++k) {
    PrintPromise(fmt::format("151 x 151: frame over one findTransformECC call, eps {:.0e}", kEccEps[k]), on_roi.frame_ms / on_roi.ecc_ms[k],
                 "{:.2f}x", 0.6, 0.35, true);
  }
  PrintPromise("151 x 151: part of the roofline", 100.0 * on_roi.floor_ms / on_roi.frame_ms, "{:.1f} %", 35, 60, false);
}

int Run(int frames, const std::vector<std::string>& rows) {
  const auto wanted = [&rows](const char* row) { return std::find(rows.begin(), rows.end(), row) != rows.end(); };
  cv::setNumThreads(1);
  PrintHeader();
  const Sequence roi = MakeSequence(151, 151, frames);
  const Sequence sensor = MakeSequence(640, 512, wanted("sensor") || wanted("threads") ? std::max(kFirstTimed + 6, frames / 4) : 1);
  if (wanted("target")) {
    const Sequence target = MakeSequence(41, 71, 2 * frames);
    const Times on_target = TimeFrames(target, EngineOf(target), Timing::kCpu, true);
    PrintTimes(target, EngineOf(target), on_target);
    PrintEcc(target, on_target);
  }
  if (wanted("roi") || wanted("superres")) {
    const Times on_roi = TimeFrames(roi, EngineOf(roi), Timing::kCpu, true);
    PrintTimes(roi, EngineOf(roi), on_roi);
    PrintEcc(roi, on_roi);
    PrintRoiPromises(on_roi);
#ifdef TREM_BENCH_SUPERRES
    const double superres_ms = wanted("superres") ? SuperresMs() : 0.0;
    if (superres_ms > 0.0) {
      PrintPromise(fmt::format("151 x 151: one superres frame ({:.0f} ms) over a frame", superres_ms), superres_ms / on_roi.frame_ms,
                   "{:.0f}x", 1000, 2500, false);
    }
#endif
  }
  if (wanted("sensor")) {
    const Times on_sensor = TimeFrames(sensor, EngineOf(sensor), Timing::kCpu, false);
    PrintTimes(sensor, EngineOf(sensor), on_sensor);
    PrintPromise("640 x 512: frame over memcpy", on_sensor.frame_ms / on_sensor.memcpy_ms, "{:.2f}x", 4, 2, true);
    fmt::print("640 x 512: update alone over memcpy {:.2f}x\n", on_sensor.update_ms / on_sensor.memcpy_ms);
  }
  if (wanted("threads")) PrintThreads(roi, sensor);
  return 0;
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  int frames = 60;
  CLI::App app("Time of a frame beside peers and the machine's limit");
  app.add_option("--frames", frames, "Frames of the 151 x 151 row")->check(CLI::Range(10, 10000));
  std::vector<std::string> rows = trem::bench::kRows;
  app.add_option("--rows", rows, "What is measured")->check(CLI::IsMember(trem::bench::kRows));
  CLI11_PARSE(app, argc, argv);
  return trem::bench::Run(frames, rows);
}
