#include "worker/app/simulate_command.h"
#include "mosaic/base/exit_code.h"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "worker/app/usage.h"
#include "worker/simulate/simulation.h"

namespace trem {
namespace {

constexpr const char* kExamples =
    "\nThe truth is laid on flat ground so that one truth pixel is 1/3 of a sensor pixel (--truth-cells-per-pixel); --gsd gives the "
    "scale.\n"
    "Grey levels are those of an 8-bit sensor.\n"
    "\nExamples:\n"
    "  trem simulate -o sortie                                  procedural terrain, straight leg, looking down\n"
    "  trem simulate truth.jpg -o sortie --width 256 --height 200 --frames 200 --path line\n"
    "  trem simulate truth.jpg -o sortie --pitch-deg -45        oblique\n"
    "  trem simulate truth.tif -o sortie --path lawnmower --frames 600 --movers 10 --drop 0.02\n"
    "  trem run sortie/sortie.textproto -o mosaic.tif           and what it is good for\n";

struct Arguments {
  SimulationOptions options;
  std::string directory;
  bool quiet = false;
  bool json = false;
};

void AddSensorOptions(CLI::App* app, SimulationOptions* o) {
  const char* group = "Sensor";
  app->add_option("--width", o->width_px, "Width of a frame, pixels")->group(group);
  app->add_option("--height", o->height_px, "Height of a frame, pixels")->group(group);
  app->add_option("--gsd", o->gsd_m, "Ground sample distance at the image centre, metres")->group(group);
  app->add_option("--truth-cells-per-pixel", o->cells_per_pixel, "Truth pixels along one sensor pixel")->group(group);
  app->add_option("--hfov-deg", o->hfov_deg, "Horizontal field of view; the distance follows from it")->group(group);
  app->add_option("--psf-sigma-px", o->psf_sigma_px, "Gaussian optics, sensor pixels")->group(group);
  app->add_option("--fill-factor", o->fill_factor, "Side of the detector's box, sensor pixels")->group(group);
  app->add_option("--bits", o->bit_depth, "8 or 16 (then a grey level is 256 counts)")->group(group);
  app->add_option("--gain", o->gain, "Frame = gain * truth + offset")->group(group);
  app->add_option("--offset", o->offset, "Grey levels")->group(group);
  app->add_option("--gain-drift", o->gain_drift, "Smooth drift, standard deviation, relative")->group(group);
  app->add_option("--offset-drift", o->offset_drift, "Smooth drift, standard deviation, grey levels")->group(group);
  app->add_option("--vignetting", o->vignetting, "Part of the gain lost in the image's corners")->group(group);
  app->add_option("--exposure-step", o->exposure_step, "The gain steps down and up again by this part, five times")->group(group);
  app->add_option("--noise-sigma", o->noise_sigma, "White noise, grey levels")->group(group);
  app->add_option("--shot-noise", o->shot_noise, "Photon noise: variance per grey level")->group(group);
  app->add_option("--fixed-pattern-sigma", o->fixed_pattern_sigma, "Constant offset of each pixel, grey levels")->group(group);
  app->add_option("--dead-pixels", o->dead_pixel_fraction, "Fraction of pixels stuck at a level")->group(group);
}

void AddFlightOptions(CLI::App* app, SimulationOptions* o) {
  const char* group = "Flight";
  static const std::map<std::string, SimulatedPath> kPaths = {
      {"line", SimulatedPath::kLine}, {"lawnmower", SimulatedPath::kLawnmower}, {"dwell", SimulatedPath::kDwell}};
  app->add_option("--frames", o->frame_count, "Exposures")->group(group);
  app->add_option("--path", o->path, "line, lawnmower or dwell")
      ->transform(CLI::Validator(
          [](std::string& text) -> std::string {
            const auto found = kPaths.find(text);
            if (found == kPaths.end()) return "'" + text + "' is not a path; expected line, lawnmower or dwell";
            text = std::to_string(static_cast<int>(found->second));
            return {};
          },
          ""))
      ->default_str("line")
      ->group(group);
  app->add_option("--pitch-deg", o->pitch_deg, "Elevation of the optical axis: -90 (down) to -30")->group(group);
  app->add_option("--yaw-deg", o->yaw_deg, "Direction of the image's up, from true north")->group(group);
  app->add_option("--speed-px", o->speed_px, "Ground motion per frame, sensor pixels; 0: as the truth and --frames allow, at most 4")
      ->group(group);
  app->add_option("--sidelap", o->sidelap, "Of a lawnmower's legs, fraction of the footprint")->group(group);
  app->add_option("--rate-hz", o->frame_rate_hz, "Exposures per second")->group(group);
  app->add_option("--wander-deg", o->wander_deg, "Slow attitude wander, amplitude")->group(group);
  app->add_option("--jitter-deg", o->jitter_deg, "White attitude jitter, standard deviation")->group(group);
  app->add_option("--position-wander-m", o->position_wander_m, "Slow camera position wander, amplitude")->group(group);
  app->add_option("--drop", o->drop_fraction, "Fraction of exposures that leave no frame")->group(group);
}

void AddPlaceAndErrorOptions(CLI::App* app, SimulationOptions* o) {
  app->add_option("--origin-lat", o->origin_lat_deg, "Latitude of the truth's centre")->group("Place");
  app->add_option("--origin-lon", o->origin_lon_deg, "Longitude of the truth's centre")->group("Place");
  app->add_option("--ground-elevation-m", o->ground_elevation_m, "Elevation of the flat ground, or the middle of the hills")->group("Place");
  app->add_option("--relief-m", o->relief_m, "Hills, peak to peak; the elevation model is written to truth/dem.tif")->group("Place");
  app->add_option("--terrain-width", o->terrain_width_cells, "Width of a procedural terrain, truth pixels")->group("Place");
  app->add_option("--terrain-height", o->terrain_height_cells, "Height of a procedural terrain, truth pixels")->group("Place");
  app->add_option("--movers", o->mover_count, "Bright and dark things moving over the ground")->group("Place");
  app->add_option("--gps-bias-m", o->gps_bias_m, "Constant horizontal position error, in a random direction")->group("Telemetry errors");
  app->add_option("--gps-noise-m", o->gps_noise_m, "White, each axis, standard deviation")->group("Telemetry errors");
  app->add_option("--attitude-noise-deg", o->attitude_noise_deg, "White, about each camera axis, standard deviation")
      ->group("Telemetry errors");
  app->add_option("--attitude-bias-deg", o->attitude_bias_deg, "Constant, about each camera axis, standard deviation")
      ->group("Telemetry errors");
  app->add_option("--control-points", o->control_count, "Ground control points, written to gcp.csv")->group("Ground control");
  app->add_option("--control-noise-px", o->control_noise_px, "Error of a control point's pixel, each axis, standard deviation")
      ->group("Ground control");
}

// Declares the whole command line; values land in `a`.
void Declare(CLI::App* app, Arguments* a) {
  app->option_defaults()->always_capture_default()->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  app->add_option("TRUTH", a->options.truth_path,
                  "Image of the ground (PNG, JPEG, TIFF, anything GDAL reads). Default: a procedural terrain")
      ->always_capture_default(false);
  app->add_option("-o,--output", a->directory, "Folder to make")->required()->always_capture_default(false);
  app->add_option("--seed", a->options.seed, "Of every random stream");
  app->add_option("--threads", a->options.thread_count, "0: all cores; the result is the same for any number");
  app->add_flag("--overwrite", a->options.overwrite, "Replace a former simulation in the folder");
  app->add_flag("-q,--quiet", a->quiet, "No progress");
  app->add_flag("--json", a->json, "Print the summary as JSON");
  AddSensorOptions(app, &a->options);
  AddFlightOptions(app, &a->options);
  AddPlaceAndErrorOptions(app, &a->options);
  app->footer(kExamples);
}

// A bar where somebody watches, a line every quarter of the way elsewhere.
class Progress {
 public:
  void operator()(int done, int total) {
    if (terminal_) {
      constexpr int kWidth = 40;
      const int filled = total > 0 ? done * kWidth / total : kWidth;
      fmt::print(stderr, "\rrendering [{:<{}}] {}/{}{}", std::string(static_cast<std::size_t>(filled), '#'), kWidth, done, total,
                 done == total ? "\n" : "");
    } else if (done * 4 / total != quarter_) {
      quarter_ = done * 4 / total;
      fmt::print(stderr, "rendered {} of {} frames\n", done, total);
    }
    std::fflush(stderr);
  }

 private:
  bool terminal_ = isatty(STDERR_FILENO) != 0;
  int quarter_ = 0;
};

void PrintSummary(const Arguments& a, const SimulationSummary& s) {
  if (a.json) {
    const nlohmann::ordered_json json = {
        {"directory", a.directory}, {"frames", s.frame_count},           {"dropped", s.dropped_count},        {"speed_px", s.speed_px},
        {"height_m", s.height_m},   {"gps_bias_e_m", s.gps_bias_east_m}, {"gps_bias_n_m", s.gps_bias_north_m}};
    fmt::print("{}\n", json.dump(2));
    return;
  }
  fmt::print(
      "{}: {} frames of {} x {} px ({} dropped), {:.2f} px a frame, camera {:.0f} m above ground, position bias {:+.2f} m east {:+.2f} m "
      "north\n",
      a.directory, s.frame_count, a.options.width_px, a.options.height_px, s.dropped_count, s.speed_px, s.height_m, s.gps_bias_east_m,
      s.gps_bias_north_m);
  fmt::print("next: trem run {}/sortie.textproto -o mosaic.tif\n", a.directory);
}

}  // namespace

int RunSimulateCommand(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Renders a sortie with known truth: frames, telemetry with errors, and the truth to score a mosaic against.",
               "trem simulate");
  Declare(&app, &arguments);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  Progress progress;
  const Result<SimulationSummary> summary = Simulate(arguments.options, arguments.directory, [&](int done, int total) {
    if (!arguments.quiet) progress(done, total);
  });
  if (!summary.ok()) {
    fmt::print(stderr, "trem simulate: {}\n", summary.status().message());
    return ExitCodeOf(summary.status());
  }
  PrintSummary(arguments, *summary);
  return 0;
}

}  // namespace trem
