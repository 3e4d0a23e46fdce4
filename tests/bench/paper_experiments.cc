// Reproduces the experiments of "Temporal Resolution Enhancement from Motion - application to airborne imagery" (EMRS DTC TEP, year 2) on
// simulated frames with known truth, and draws the pictures of docs/PAPER_EXPERIMENTS.md:
//   target    a target of 41 x 71 px: PSNR and change of the scene against the number of frames; one frame beside the scene
//   mapping   199 frames of an oblique line of flight through a ROI of 151 x 151 px: affine coefficients from frame to frame and their
//             error against the simulated flight; one frame beside the scene
// and prints when each becomes stable and what a frame costs.
//
// usage: paper_experiments --out DIRECTORY
#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "mosaic/base/file.h"
#include "mosaic/publish/line_chart.h"
#include "tests/bench/peers/bench_scene.h"
#include "worker/simulate/records.h"
#include "worker/simulate/simulation.h"
#include "worker/tre/mapping_engine.h"

namespace trem::bench {
namespace {

namespace fs = std::filesystem;

constexpr int kRatio = 3;
constexpr int kTargetFrames = 60;
constexpr int kMappingFrames = 199;
constexpr int kMappingRoi = 151;
// "Stable": no later scene scores worse than the last one by more than this ...
constexpr double kStableDb = 1.0;
// ... and no later frame-to-frame registration errs by more than this at a ROI corner [sensor px].
constexpr double kStablePx = 0.1;

struct Run {
  EngineResult result;
  SceneSnapshot last;
  double ms_per_frame = 0.0;
};

Result<Run> Enhance(const Roi& roi, std::span<const FrameInput> frames, const PsfParameters& psf) {
  EngineOptions options;
  options.psf = psf;
  options.ratio = kRatio;
  Run run;
  const SnapshotSink sink = [&](int, const SceneSnapshot& snapshot) {
    run.last = snapshot;
    return Status{};
  };
  const auto start = std::chrono::steady_clock::now();
  TREM_ASSIGN_OR_RETURN(run.result, RunMapping(roi, frames, options, sink, {}));
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  run.ms_per_frame = 1e3 * seconds / static_cast<double>(frames.size());
  return run;
}

// The scene in the view of a frame, three cells a pixel; `view` is scene_from_sensor.
cv::Mat1f SceneInView(const SceneSnapshot& snapshot, const PlanarMap& view, const Roi& roi) {
  cv::Mat1f picture(kRatio * roi.height(), kRatio * roi.width());
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x) {
      const Eigen::Vector2d u(roi.x0 + static_cast<double>(x) / kRatio, roi.y0 + static_cast<double>(y) / kRatio);
      const Eigen::Vector2d cell = view * u;
      picture(y, x) = SampleClamped(snapshot.intensity, cell.x() - snapshot.extent.x0, cell.y() - snapshot.extent.y0);
    }
  }
  return picture;
}

cv::Mat1f Nearest(const Image<float>& frame) {
  cv::Mat1f picture(kRatio * frame.height(), kRatio * frame.width());
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x) {
      picture(y, x) = frame.at(std::min((x + 1) / kRatio, frame.width() - 1), std::min((y + 1) / kRatio, frame.height() - 1));
    }
  }
  return picture;
}

cv::Mat1f Enlarged(const Image<float>& frame) {
  cv::Mat1f picture(kRatio * frame.height(), kRatio * frame.width());
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x) {
      picture(y, x) = SampleClamped(frame, static_cast<double>(x) / kRatio, static_cast<double>(y) / kRatio);
    }
  }
  return picture;
}

// Pictures side by side in one stretch of grey: the 1st to 99th percentile of the last one.
Status WritePanels(const std::vector<cv::Mat1f>& panels, const fs::path& path) {
  std::vector<float> values(panels.back().begin(), panels.back().end());
  std::sort(values.begin(), values.end());
  const double low = values[values.size() / 100];
  const double high = values[values.size() - 1 - values.size() / 100];
  cv::Mat row;
  for (const cv::Mat1f& panel : panels) {
    cv::Mat grey;
    panel.convertTo(grey, CV_8U, 255.0 / (high - low), -255.0 * low / (high - low));
    if (!row.empty()) cv::hconcat(row, cv::Mat(grey.rows, 6, CV_8U, cv::Scalar(255)), row);
    if (row.empty()) {
      row = grey;
    } else {
      cv::hconcat(row, grey, row);
    }
  }
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".png", row, bytes, {cv::IMWRITE_PNG_COMPRESSION, 9})) return Failed("cannot encode " + path.string());
  return WriteFileAtomically(path, std::string(bytes.begin(), bytes.end()));
}

Status WriteChart(const LineChart& chart, const fs::path& path) {
  TREM_ASSIGN_OR_RETURN(const std::string png, LineChartPng(chart));
  return WriteFileAtomically(path, png);
}

std::vector<double> CountUp(std::size_t first, std::size_t count) {
  std::vector<double> numbers;
  for (std::size_t i = 0; i < count; ++i) numbers.push_back(static_cast<double>(first + i));
  return numbers;
}

// The first index from which on `good` holds to the end.
template <typename Good>
std::size_t StableFrom(const std::vector<double>& values, const Good& good) {
  std::size_t first = values.size();
  while (first > 0 && good(values[first - 1])) --first;
  return first;
}

// --- A target of 41 x 71 px -------------------------------------------------------------------------------------------------------

testing::RenderedSequence TargetSequence(const Roi& roi, const PsfParameters& psf) {
  testing::SequenceOptions options;
  options.motion = testing::CameraMotion::kDwell;
  options.frame_count = kTargetFrames;
  options.roi_px = std::max(roi.width(), roi.height());
  options.speed_px = 0.02;
  options.psf_sigma_px = psf.sigma_px;
  options.fill_factor = psf.fill_factor;
  options.seed = 5;
  constexpr int kBoards = 2;
  testing::RenderedSequence sequence = testing::RenderSequence(
      ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), options.seed, kBoards), options);
  sequence.roi = roi;
  for (FrameInput& frame : sequence.frames) {
    Image<float> cut(roi.width(), roi.height());
    for (int y = 0; y < roi.height(); ++y) std::copy_n(frame.pixels.row(y), roi.width(), cut.row(y));
    frame.pixels = std::move(cut);
  }
  return sequence;
}

Status TargetExperiment(const fs::path& out) {
  const Roi roi{0, 0, 41, 71};
  const PsfParameters psf{0.6, 0.9};
  const testing::RenderedSequence sequence = TargetSequence(roi, psf);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  std::vector<double> scene_db, change;
  double bicubic_db = 0.0;
  cv::Mat1f before;
  std::vector<cv::Mat1f> panels{Nearest(sequence.frames[0].pixels), Enlarged(sequence.frames[0].pixels)};
  double ms_per_frame = 0.0;
  for (std::size_t n = 1; n <= sequence.frames.size(); ++n) {
    TREM_ASSIGN_OR_RETURN(const Run run, Enhance(roi, std::span(sequence.frames).first(n), psf));
    const testing::SnapshotScore score = testing::ScoreSnapshot(sequence, filtered, run.last, 0, 0.4, 1e9);
    scene_db.push_back(score.scene_db.value_or(0.0));
    bicubic_db = score.bicubic_db.value_or(0.0);
    const cv::Mat1f scene = SceneInView(run.last, run.result.segments[0].chain[0].registration.view.scene_from_sensor, roi);
    const cv::Rect middle(12, 12, scene.cols - 24, scene.rows - 24);
    change.push_back(before.empty() ? std::nan("") : cv::norm(scene(middle), before(middle)) / std::sqrt(middle.area()));
    before = scene;
    if (n == 5 || n == 30 || n == sequence.frames.size()) panels.push_back(scene);
    ms_per_frame = run.ms_per_frame;
  }
  const double last = scene_db.back();
  const std::size_t stable = StableFrom(scene_db, [&](double db) { return db > last - kStableDb; }) + 1;
  fmt::print("target 41 x 71 px: bicubic {:.2f} dB; scene {:.2f} dB after 5, {:.2f} after 30, {:.2f} after {} frames\n", bicubic_db,
             scene_db[4], scene_db[29], last, scene_db.size());
  fmt::print(
      "  within {:.0f} dB of the last scene from frame {} on (the paper: stable after about 30); it changes by {:.2f} grey levels a frame "
      "at 30\n",
      kStableDb, stable, change[29]);
  fmt::print("  {:.2f} ms a frame, snapshot included (the paper: 20 s in 2008)\n", ms_per_frame);
  TREM_RETURN_IF_ERROR(WritePanels(panels, out / "paper_target.png"));
  const std::vector<double> x = CountUp(1, scene_db.size());
  const std::vector<double> flat(x.size(), bicubic_db);
  TREM_RETURN_IF_ERROR(WriteChart({"Target of 41 x 71 px", "frames", "PSNR [dB]", {{"scene", x, scene_db}, {"bicubic frame", x, flat}}},
                                  out / "paper_target_psnr.png"));
  return WriteChart({"Target of 41 x 71 px", "frames", "change of the scene by one frame [grey levels, rms]", {{"", x, change}}},
                    out / "paper_target_change.png");
}

// --- 199 frames of an oblique line of flight --------------------------------------------------------------------------------------

struct Simulated {
  SimulationRecord record;
  Roi roi;
  std::vector<FrameInput> frames;
};

Result<Simulated> SimulateOblique(const fs::path& folder) {
  SimulationOptions options;
  options.frame_count = kMappingFrames;
  options.pitch_deg = -45.0;
  options.speed_px = 1.9;
  options.seed = 3;
  options.overwrite = true;
  TREM_RETURN_IF_ERROR(CheckSimulationOptions(options));
  TREM_ASSIGN_OR_RETURN(const SimulationSummary summary, Simulate(options, folder, [](int, int) {}));
  Simulated s;
  TREM_ASSIGN_OR_RETURN(s.record, ReadSimulation(folder));
  const int x0 = (options.width_px - kMappingRoi) / 2;
  const int y0 = (options.height_px - kMappingRoi) / 2;
  s.roi = {x0, y0, x0 + kMappingRoi, y0 + kMappingRoi};
  for (int t = 0; t < summary.frame_count; ++t) {
    const fs::path path = folder / "frames" / FrameName(t);
    const cv::Mat1b grey = cv::imread(path.string(), cv::IMREAD_GRAYSCALE);
    if (grey.empty()) return Failed("cannot read back " + path.string());
    FrameInput frame;
    frame.frame_index = t;
    frame.pixels = Image<float>(s.roi.width(), s.roi.height());
    for (int y = 0; y < s.roi.height(); ++y) {
      for (int x = 0; x < s.roi.width(); ++x) frame.pixels.at(x, y) = grey(s.roi.y0 + y, s.roi.x0 + x);
    }
    s.frames.push_back(std::move(frame));
  }
  return s;
}

// Where sensor point `u` of frame t was in frame t - 1, by the simulated flight.
Eigen::Vector2d TruePrevious(const SimulationRecord& record, std::size_t t, const Eigen::Vector2d& u) {
  const SimulationOptions& o = record.options;
  const Eigen::Vector2d ground = GroundFromPixel(record.flight.exposures[t].camera, record.flight.focal_px, o.width_px, o.height_px, u);
  return PixelFromGround(record.flight.exposures[t - 1].camera, record.flight.focal_px, o.width_px, o.height_px, ground);
}

// Linear coefficients less the identity in thousandths.
struct FrameToFrame {
  std::vector<double> frame, a11, a12, a21, a22, error_px;
  double coefficient_rms = 0.0;  // Difference of a coefficient from the simulated flight's.
};

// The affine map through what the simulated flight does with three corners of the ROI, linear part only.
Eigen::Matrix2d TrueLinear(const Simulated& s, std::size_t t) {
  const Eigen::Vector2d origin(s.roi.x0, s.roi.y0);
  const double right = s.roi.width() - 1;
  const double down = s.roi.height() - 1;
  const Eigen::Vector2d mapped = TruePrevious(s.record, t, origin);
  Eigen::Matrix2d linear;
  linear.col(0) = (TruePrevious(s.record, t, origin + Eigen::Vector2d(right, 0.0)) - mapped) / right;
  linear.col(1) = (TruePrevious(s.record, t, origin + Eigen::Vector2d(0.0, down)) - mapped) / down;
  return linear;
}

FrameToFrame Compare(const Simulated& s, const std::vector<ChainEntry>& chain) {
  FrameToFrame found;
  for (std::size_t k = 1; k < chain.size(); ++k) {
    const auto t = static_cast<std::size_t>(chain[k].frame_index);
    if (chain[k - 1].frame_index + 1 != chain[k].frame_index) continue;
    const PlanarMap previous_from_current =
        chain[k - 1].registration.view.scene_from_sensor.Inverse() * chain[k].registration.view.scene_from_sensor;
    double largest = 0.0;
    for (const int x : {s.roi.x0, s.roi.x1 - 1}) {
      for (const int y : {s.roi.y0, s.roi.y1 - 1}) {
        const Eigen::Vector2d u(x, y);
        largest = std::max(largest, (previous_from_current * u - TruePrevious(s.record, t, u)).norm());
      }
    }
    found.coefficient_rms += 1e6 * (previous_from_current.linear - TrueLinear(s, t)).squaredNorm() / 4.0;
    found.frame.push_back(static_cast<double>(t));
    found.error_px.push_back(largest);
    found.a11.push_back(1e3 * (previous_from_current.linear(0, 0) - 1.0));
    found.a12.push_back(1e3 * previous_from_current.linear(0, 1));
    found.a21.push_back(1e3 * previous_from_current.linear(1, 0));
    found.a22.push_back(1e3 * (previous_from_current.linear(1, 1) - 1.0));
  }
  found.coefficient_rms = std::sqrt(found.coefficient_rms / static_cast<double>(std::max<std::size_t>(1, found.frame.size())));
  return found;
}

Status MappingExperiment(const fs::path& out, const fs::path& scratch) {
  TREM_ASSIGN_OR_RETURN(const Simulated s, SimulateOblique(scratch));
  const PsfParameters psf{s.record.options.psf_sigma_px, s.record.options.fill_factor};
  TREM_ASSIGN_OR_RETURN(const Run run, Enhance(s.roi, s.frames, psf));
  const std::vector<ChainEntry>& chain = run.result.segments[0].chain;
  const FrameToFrame found = Compare(s, chain);
  const std::size_t stable = StableFrom(found.error_px, [](double error) { return error < kStablePx; });
  std::vector<double> sorted = found.error_px;
  std::sort(sorted.begin(), sorted.end());
  fmt::print("mapping, {} oblique frames of {} x {} px: {} of them registered in one scene, {} segments\n", s.frames.size(), s.roi.width(),
             s.roi.height(), chain.size(), run.result.segments.size());
  fmt::print(
      "  frame-to-frame corner error: median {:.4f}, largest {:.4f} px; below {:.2f} px from frame {:.0f} on (the paper: stable after less "
      "than 20)\n",
      sorted[sorted.size() / 2], sorted.back(), kStablePx, stable < found.frame.size() ? found.frame[stable] : NAN);
  fmt::print("  linear coefficients: {:.4f} thousandths rms from the simulated flight's\n", found.coefficient_rms);
  fmt::print("  {:.2f} ms a frame, snapshots included (the paper: 20 s in 2008)\n", run.ms_per_frame);
  const ChainEntry& last = chain.back();
  const Image<float>& frame = s.frames[static_cast<std::size_t>(last.frame_index)].pixels;
  const cv::Mat1f scene = SceneInView(run.last, last.registration.view.scene_from_sensor, s.roi);
  const cv::Rect part(150, 90, 210, 210);
  TREM_RETURN_IF_ERROR(
      WritePanels({Nearest(frame)(part).clone(), Enlarged(frame)(part).clone(), scene(part).clone()}, out / "paper_mapping.png"));
  TREM_RETURN_IF_ERROR(WriteChart({"Affine coefficients from frame to frame, less the identity",
                                   "frame",
                                   "[1/1000]",
                                   {{"a11", found.frame, found.a11},
                                    {"a12", found.frame, found.a12},
                                    {"a21", found.frame, found.a21},
                                    {"a22", found.frame, found.a22}}},
                                  out / "paper_mapping_affine.png"));
  return WriteChart(
      {"Error of the frame-to-frame map at the worst ROI corner", "frame", "[sensor px]", {{"", found.frame, found.error_px}}},
      out / "paper_mapping_error.png");
}

Status RunAll(const fs::path& out, const fs::path& scratch) {
  std::error_code error;
  fs::create_directories(out, error);
  if (error) return Failed("cannot make folder " + out.string() + ": " + error.message());
  TREM_RETURN_IF_ERROR(TargetExperiment(out));
  return MappingExperiment(out, scratch);
}

}  // namespace
}  // namespace trem::bench

int main(int argc, char** argv) {
  std::string out;
  CLI::App app("The paper's experiments, with pictures");
  app.add_option("--out", out, "Folder for the pictures")->required();
  CLI11_PARSE(app, argc, argv);
  const std::filesystem::path scratch = std::filesystem::temp_directory_path() / ("trem_paper_" + std::to_string(::getpid()));
  const trem::Status status = trem::bench::RunAll(out, scratch);
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
