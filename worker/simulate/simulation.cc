#include "worker/simulate/simulation.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "mosaic/base/file.h"
#include "mosaic/raster/crs.h"
#include "worker/simulate/control_points.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/records.h"
#include "worker/simulate/relief.h"
#include "worker/simulate/renderer.h"
#include "worker/simulate/truth.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

Status CheckRange(const char* option, double value, double low, double high) {
  if (value >= low && value <= high) return {};  // False for NaN.
  return InvalidInput(fmt::format("{} is {:g}; it must be from {:g} to {:g}", option, value, low, high));
}

// Removes the unfinished folder unless it was published.
class WorkFolder {
 public:
  explicit WorkFolder(fs::path path) : path_(std::move(path)) {}
  ~WorkFolder() {
    std::error_code ignored;
    if (!published_) fs::remove_all(path_, ignored);
  }
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;
  const fs::path& path() const { return path_; }

  Status Publish(const fs::path& target) {
    std::error_code error;
    if (fs::exists(target, error)) fs::remove_all(target, error);
    if (!error) fs::rename(path_, target, error);
    if (error) return Failed("cannot put the simulation at '" + target.string() + "': " + error.message());
    published_ = true;
    return {};
  }

 private:
  fs::path path_;
  bool published_ = false;
};

Status CheckTarget(const fs::path& directory, bool overwrite) {
  std::error_code error;
  if (!fs::exists(directory, error)) return {};
  if (!fs::is_directory(directory, error)) return InvalidInput("'" + directory.string() + "' is a file; -o needs a folder");
  if (fs::is_empty(directory, error)) return {};
  if (!overwrite)
    return InvalidInput("folder '" + directory.string() +
                        "' is not empty; choose another one, or add --overwrite to replace a former simulation");
  if (!fs::exists(directory / "truth" / "simulation.json", error)) {
    return InvalidInput("folder '" + directory.string() +
                        "' holds something else than a simulation (it has no truth/simulation.json); --overwrite does not "
                        "delete it: choose another folder");
  }
  return {};
}

Result<Truth> PlaceTruth(const SimulationOptions& options) {
  Truth truth;
  if (options.truth_path.empty()) {
    truth.grey = ProceduralTerrain(options.terrain_width_cells, options.terrain_height_cells, options.seed);
  } else {
    TREM_ASSIGN_OR_RETURN(truth.grey, ReadGrey(options.truth_path));
    if (std::min(truth.grey.width(), truth.grey.height()) < 64) {
      return InvalidInput(fmt::format("truth '{}' has {} x {} cells; at least 64 x 64 are needed", options.truth_path, truth.grey.width(),
                                      truth.grey.height()));
    }
  }
  TREM_ASSIGN_OR_RETURN(const UtmFrame frame, UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg));
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d centre, frame.Forward(options.origin_lat_deg, options.origin_lon_deg));
  truth.grid.crs_wkt = frame.wkt();
  truth.grid.width = truth.grey.width();
  truth.grid.height = truth.grey.height();
  truth.grid.gsd = options.gsd_m / options.cells_per_pixel;
  truth.grid.origin_x = centre.x() - 0.5 * truth.grid.gsd * (truth.grey.width() - 1);
  truth.grid.origin_y = centre.y() + 0.5 * truth.grid.gsd * (truth.grey.height() - 1);
  truth.relief = MakeRelief(options, truth.grid);
  return truth;
}

Status WritePng(const Image<std::uint16_t>& frame, int bit_depth, const fs::path& path) {
  cv::Mat image(frame.height(), frame.width(), CV_16U, const_cast<std::uint16_t*>(frame.row(0)));
  cv::Mat narrow;
  if (bit_depth == 8) image.convertTo(narrow, CV_8U);
  try {
    if (cv::imwrite(path.string(), bit_depth == 8 ? narrow : image, {cv::IMWRITE_PNG_COMPRESSION, 3})) return {};
  } catch (const cv::Exception& error) {
    return Failed("cannot write '" + path.string() + "': " + error.what());
  }
  return Failed("cannot write '" + path.string() + "'; is the disk full?");
}

// Renders and writes every frame; threads take frames in turn, each frame's bytes depend on nothing but itself.
Status WriteFrames(const SimulationOptions& options, const Renderer& renderer, const std::vector<Exposure>& exposures,
                   const fs::path& folder, const std::function<void(int, int)>& progress) {
  const int total = static_cast<int>(exposures.size());
  std::atomic<int> next{0};
  std::mutex mutex;
  std::condition_variable changed;
  int done = 0;
  int running = 0;
  std::optional<Status> failure;
  const auto work = [&] {
    for (int i = next++; i < total; i = next++) {
      const Exposure& exposure = exposures[static_cast<std::size_t>(i)];
      Status status;
      if (!exposure.dropped) status = WritePng(renderer.Frame(exposure), options.bit_depth, folder / FrameName(exposure.index));
      const std::lock_guard lock(mutex);
      ++done;
      if (!status.ok() && !failure) failure = status;
      if (failure) next = total;
      changed.notify_one();
    }
    const std::lock_guard lock(mutex);
    --running;
    changed.notify_one();
  };
  const unsigned cores = std::max(1U, std::thread::hardware_concurrency());
  running = std::max(1, std::min(total, options.thread_count > 0 ? options.thread_count : static_cast<int>(cores)));
  std::vector<std::thread> threads;
  for (int i = running; i > 0; --i) threads.emplace_back(work);
  {
    std::unique_lock lock(mutex);
    int reported = -1;
    while (running > 0 || done > reported) {
      if (done > reported) {
        reported = done;
        lock.unlock();
        if (progress) progress(reported, total);
        lock.lock();
        continue;
      }
      changed.wait(lock);
    }
  }
  for (std::thread& thread : threads) thread.join();
  return failure ? *failure : Status();
}

}  // namespace

Status CheckSimulationOptions(const SimulationOptions& o) {
  TREM_RETURN_IF_ERROR(CheckRange("--terrain-width", o.terrain_width_cells, 64, 20000));
  TREM_RETURN_IF_ERROR(CheckRange("--terrain-height", o.terrain_height_cells, 64, 20000));
  TREM_RETURN_IF_ERROR(CheckRange("--origin-lat", o.origin_lat_deg, -80, 84));
  TREM_RETURN_IF_ERROR(CheckRange("--origin-lon", o.origin_lon_deg, -180, 180));
  TREM_RETURN_IF_ERROR(CheckRange("--ground-elevation-m", o.ground_elevation_m, -500, 9000));
  TREM_RETURN_IF_ERROR(CheckRange("--relief-m", o.relief_m, 0, 5000));
  TREM_RETURN_IF_ERROR(CheckRange("--width", o.width_px, 16, 8192));
  TREM_RETURN_IF_ERROR(CheckRange("--height", o.height_px, 16, 8192));
  TREM_RETURN_IF_ERROR(CheckRange("--gsd", o.gsd_m, 0.001, 100));
  TREM_RETURN_IF_ERROR(CheckRange("--truth-cells-per-pixel", o.cells_per_pixel, 1, 16));
  TREM_RETURN_IF_ERROR(CheckRange("--hfov-deg", o.hfov_deg, 0.1, 120));
  TREM_RETURN_IF_ERROR(CheckRange("--psf-sigma-px", o.psf_sigma_px, 0.25, 5));
  TREM_RETURN_IF_ERROR(CheckRange("--fill-factor", o.fill_factor, 0.05, 1));
  if (o.bit_depth != 8 && o.bit_depth != 16) return InvalidInput(fmt::format("--bits is {}; it must be 8 or 16", o.bit_depth));
  TREM_RETURN_IF_ERROR(CheckRange("--gain", o.gain, 0.01, 10));
  TREM_RETURN_IF_ERROR(CheckRange("--offset", o.offset, -255, 255));
  TREM_RETURN_IF_ERROR(CheckRange("--gain-drift", o.gain_drift, 0, 0.3));
  TREM_RETURN_IF_ERROR(CheckRange("--offset-drift", o.offset_drift, 0, 100));
  TREM_RETURN_IF_ERROR(CheckRange("--vignetting", o.vignetting, 0, 0.9));
  TREM_RETURN_IF_ERROR(CheckRange("--exposure-step", o.exposure_step, 0, 0.9));
  TREM_RETURN_IF_ERROR(CheckRange("--noise-sigma", o.noise_sigma, 0, 100));
  TREM_RETURN_IF_ERROR(CheckRange("--shot-noise", o.shot_noise, 0, 100));
  TREM_RETURN_IF_ERROR(CheckRange("--fixed-pattern-sigma", o.fixed_pattern_sigma, 0, 100));
  TREM_RETURN_IF_ERROR(CheckRange("--dead-pixels", o.dead_pixel_fraction, 0, 0.5));
  TREM_RETURN_IF_ERROR(CheckRange("--movers", o.mover_count, 0, 10000));
  TREM_RETURN_IF_ERROR(CheckRange("--frames", o.frame_count, 1, 99999));
  TREM_RETURN_IF_ERROR(CheckRange("--pitch-deg", o.pitch_deg, -90, -30));
  TREM_RETURN_IF_ERROR(CheckRange("--yaw-deg", o.yaw_deg, -360, 360));
  TREM_RETURN_IF_ERROR(CheckRange("--speed-px", o.speed_px, 0, 1000));
  TREM_RETURN_IF_ERROR(CheckRange("--sidelap", o.sidelap, 0, 0.95));
  TREM_RETURN_IF_ERROR(CheckRange("--rate-hz", o.frame_rate_hz, 0.01, 10000));
  TREM_RETURN_IF_ERROR(CheckRange("--wander-deg", o.wander_deg, 0, 5));
  TREM_RETURN_IF_ERROR(CheckRange("--jitter-deg", o.jitter_deg, 0, 1));
  TREM_RETURN_IF_ERROR(CheckRange("--position-wander-m", o.position_wander_m, 0, 1000));
  TREM_RETURN_IF_ERROR(CheckRange("--drop", o.drop_fraction, 0, 0.9));
  TREM_RETURN_IF_ERROR(CheckRange("--gps-bias-m", o.gps_bias_m, 0, 10000));
  TREM_RETURN_IF_ERROR(CheckRange("--gps-noise-m", o.gps_noise_m, 0, 1000));
  TREM_RETURN_IF_ERROR(CheckRange("--attitude-noise-deg", o.attitude_noise_deg, 0, 10));
  TREM_RETURN_IF_ERROR(CheckRange("--attitude-bias-deg", o.attitude_bias_deg, 0, 10));
  TREM_RETURN_IF_ERROR(CheckRange("--control-points", o.control_count, 0, 1000));
  TREM_RETURN_IF_ERROR(CheckRange("--control-noise-px", o.control_noise_px, 0, 100));
  return CheckRange("--threads", o.thread_count, 0, 1024);
}

Result<SimulationSummary> Simulate(const SimulationOptions& options, const fs::path& directory,
                                   const std::function<void(int, int)>& progress) {
  TREM_RETURN_IF_ERROR(CheckSimulationOptions(options));
  const fs::path target = fs::absolute(directory).lexically_normal();
  const fs::path target_no_slash = target.has_filename() ? target : target.parent_path();
  TREM_RETURN_IF_ERROR(CheckTarget(target_no_slash, options.overwrite));
  TREM_ASSIGN_OR_RETURN(const Truth truth, PlaceTruth(options));
  TREM_ASSIGN_OR_RETURN(const Flight flight, PlanFlight(options, truth));

  const fs::path beside = target_no_slash.parent_path();
  TREM_RETURN_IF_ERROR(MakeDirectories(beside));
  TREM_RETURN_IF_ERROR(CheckWritable(beside));
  WorkFolder work(beside / fmt::format(".{}.partial.{}", target_no_slash.filename().string(), getpid()));
  TREM_RETURN_IF_ERROR(MakeDirectories(work.path() / "frames"));
  TREM_RETURN_IF_ERROR(MakeDirectories(work.path() / "truth"));
  TREM_RETURN_IF_ERROR(WriteTruth(truth, work.path() / "truth" / "truth.tif"));
  if (truth.relief) {
    TREM_RETURN_IF_ERROR(WriteRelief(*truth.relief, options.ground_elevation_m, truth.grid.crs_wkt, work.path() / "truth" / "dem.tif"));
  }
  if (options.control_count > 0) {
    TREM_ASSIGN_OR_RETURN(const std::string control, ControlPointsCsv(options, truth, flight));
    TREM_RETURN_IF_ERROR(WriteFileAtomically(work.path() / "gcp.csv", control));
  }
  const Renderer renderer(options, truth, flight, MakeMovers(options, flight));
  TREM_RETURN_IF_ERROR(WriteFrames(options, renderer, flight.exposures, work.path() / "frames", progress));
  TREM_RETURN_IF_ERROR(WriteRecords(options, truth, flight, work.path()));
  TREM_RETURN_IF_ERROR(work.Publish(target_no_slash));

  SimulationSummary summary;
  summary.dropped_count =
      static_cast<int>(std::count_if(flight.exposures.begin(), flight.exposures.end(), [](const Exposure& e) { return e.dropped; }));
  summary.frame_count = options.frame_count - summary.dropped_count;
  summary.speed_px = flight.speed_px;
  summary.height_m = flight.exposures.front().camera.height_m;
  summary.gps_bias_east_m = flight.gps_bias_m.x();
  summary.gps_bias_north_m = flight.gps_bias_m.y();
  return summary;
}

}  // namespace trem
