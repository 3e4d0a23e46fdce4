// sortie_bench: do mosaics lie where they should, and do they show what their scenes show?
//
// Question: on simulated sorties of every kind that the project promises to map, what are coverage, distortion, sharpness and position error
// of the mosaic, and do its stated standard errors hold?
// Baseline: the bicubic interpolation of single frames with their true poses, and the median of the same scenes at their true places.
// Method: `trem simulate`, `trem run` and `trem_score` as a user would call them; the table is for docs/BENCHMARKS.md.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using Strings = std::vector<std::string>;

struct Sortie {
  std::string name;
  std::string what;
  Strings simulation;
  Strings run;  // "=@/" names a path within the simulation.
};

struct Arguments {
  std::string truth;
  std::string folder;
  Strings only;
  std::string programs;
  int workers = 2;
  bool keep = false;
  bool control = false;
};

std::vector<Sortie> Sorties() {
  return {
      {"nadir", "straight leg, straight down", {"--frames", "200"}, {}},
      {"oblique", "45 degrees oblique, 5 degrees field of view", {"--frames", "200", "--pitch-deg", "-45"}, {}},
      {"wide",
       "60 degrees down, 60 degrees field of view",
       {"--frames", "200", "--pitch-deg", "-60", "--hfov-deg", "60"},
       {"--set", "tre.view_model=PROJECTIVE"}},
      {"lawnmower",
       "three legs, movers, exposure steps",
       {"--frames", "320", "--speed-px", "5", "--path", "lawnmower", "--movers", "12", "--exposure-step", "0.25"},
       {}},
      {"vignetting",
       "three legs, exposure steps, corners a third darker",
       {"--frames", "320", "--speed-px", "5", "--path", "lawnmower", "--exposure-step", "0.25", "--vignetting", "0.33"},
       {}},
      {"faulty",
       "16 bit, fixed pattern, dead pixels, heavy noise, dropped frames",
       {"--frames", "200", "--bits", "16", "--fixed-pattern-sigma", "3", "--dead-pixels", "0.003", "--noise-sigma", "5", "--drop", "0.05"},
       {}},
      {"relief",
       "hills of a tenth of the height, 30 degrees field of view",
       {"--frames", "200", "--hfov-deg", "30", "--relief-m", "14.3"},
       {"--set", "telemetry.dem_path=@/truth/dem.tif"}},
  };
}

// Runs a program of this build, or of `folder`; its standard output, or what it complained about.
Result<std::string> Call(const std::string& folder, const std::string& program, const Strings& arguments) {
  Strings argv = {folder.empty() ? testing::BinaryPath(program).string() : (fs::path(folder) / program).string()};
  argv.insert(argv.end(), arguments.begin(), arguments.end());
  const testing::Completed completed = testing::RunProgram(argv, std::chrono::minutes(60));
  if (completed.exit_code == 0) return completed.stdout_text;
  return Failed(fmt::format("{} {} ended with exit code {}: {}", program, arguments.front(), completed.exit_code, completed.stderr_text));
}

Strings With(Strings first, const Strings& more) {
  first.insert(first.end(), more.begin(), more.end());
  return first;
}

Result<nlohmann::json> RunAndScore(const Arguments& arguments, const Sortie& sortie, const fs::path& simulation, const std::string& suffix) {
  const fs::path mosaic = fs::path(arguments.folder) / (sortie.name + suffix + ".tif");
  const std::string work = mosaic.string() + ".work";
  Strings options = sortie.run;
  for (std::string& option : options) {
    const std::size_t at = option.find("=@/");
    if (at != std::string::npos) option.replace(at + 1, 1, fs::absolute(simulation).string());
  }
  TREM_RETURN_IF_ERROR(Call(arguments.programs, "trem",
                            With({"run", (simulation / "sortie.textproto").string(), "-o", mosaic.string(), "--quiet", "--keep-work",
                                  "--workers", std::to_string(arguments.workers)},
                                 options))
                           .status());
  TREM_ASSIGN_OR_RETURN(
      const std::string text,
      Call(arguments.programs, "trem_score", {"--simulation", simulation.string(), "--mosaic", mosaic.string(), "--work", work, "--json"}));
  std::error_code ignored;
  if (!arguments.keep) fs::remove_all(work, ignored);
  return nlohmann::json::parse(text);
}

Status Bench(const Arguments& arguments, const Sortie& sortie) {
  const fs::path simulation = fs::path(arguments.folder) / sortie.name;
  Strings simulate = {"simulate"};
  if (!arguments.truth.empty()) simulate.push_back(arguments.truth);
  simulate = With(simulate, {"-o", simulation.string(), "--quiet", "--overwrite", "--control-points", "4"});
  TREM_RETURN_IF_ERROR(Call(arguments.programs, "trem", With(simulate, sortie.simulation)).status());
  const auto start = std::chrono::steady_clock::now();
  TREM_ASSIGN_OR_RETURN(const nlohmann::json score, RunAndScore(arguments, sortie, simulation, ""));
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::string controlled = "-";
  if (arguments.control) {
    Sortie with = sortie;
    with.run = With(with.run, {"--set", "control.path=" + (simulation / "gcp.csv").string(), "--set", "control.pixel_sigma_px=0.2", "--set",
                               "control.survey_sigma_m=0.02"});
    TREM_ASSIGN_OR_RETURN(const nlohmann::json score_with, RunAndScore(arguments, with, simulation, "-control"));
    controlled =
        fmt::format("{:.3f} px, {:.3f} px", score_with.at("absolute_error_m").get<double>() / score_with.at("sensor_gsd_m").get<double>(),
                    score_with.at("distortion_p95_px").get<double>());
  }
  const auto number = [&](const char* key) { return score.at(key).get<double>(); };
  fmt::print(
      "| {} | {:.4f} | {:.3f} / {:.3f} px | {:.2f} / {:.2f} dB | {:+.2f} dB | {:.2f} dB | {:.2f} / {:.2f} | {:.3f} m ({:.3f} m) | {} | "
      "{:.3f} m | {:.0f} s |\n",
      sortie.what, number("coverage"), number("distortion_median_px"), number("distortion_p95_px"), number("psnr_db"),
      number("bicubic_psnr_db"), number("gain_db"), number("placement_loss_db"), number("level_rms"), number("seam_p95"),
      number("absolute_error_m"), number("gps_bias_m"), controlled, number("scene_sigma_m"), seconds);
  std::fflush(stdout);
  return {};
}

Status BenchAll(const Arguments& arguments) {
  fmt::print(
      "| sortie | coverage | distortion median / 95 % | PSNR mosaic / bicubic frame | gain | lost by placement | brightness: "
      "rms of places / 95 % of steps | absolute error (GPS bias) | with 4 control points: absolute error, distortion 95 % | stated "
      "standard error | time |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n");
  for (const Sortie& sortie : Sorties()) {
    if (!arguments.only.empty() && std::find(arguments.only.begin(), arguments.only.end(), sortie.name) == arguments.only.end()) continue;
    TREM_RETURN_IF_ERROR(Bench(arguments, sortie).WithPrefix(sortie.name));
  }
  return {};
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Arguments arguments;
  CLI::App app("Simulates sorties, makes their mosaics and scores them; prints a table.", "sortie_bench");
  app.add_option("--truth", arguments.truth, "Image of the ground; default: a procedural terrain");
  app.add_option("-o,--output", arguments.folder, "Folder for sorties and mosaics")->required();
  app.add_option("--only", arguments.only, "Names of sorties: nadir, oblique, wide, lawnmower, vignetting, faulty, relief");
  app.add_option("--programs", arguments.programs, "Folder of the programs to measure; default: those of this build");
  app.add_option("--workers", arguments.workers, "Worker processes")->check(CLI::Range(1, 64))->capture_default_str();
  app.add_flag("--keep", arguments.keep, "Keep the work folders of the runs");
  app.add_flag("--control", arguments.control, "Make every mosaic a second time, with four ground control points");
  CLI11_PARSE(app, argc, argv);
  const trem::Status status = trem::BenchAll(arguments);
  if (status.ok()) return 0;
  fmt::print(stderr, "sortie_bench: {}\n", status.message());
  return 1;
}
