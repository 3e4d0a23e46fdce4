// align_scale: how long does the alignment of a long sortie take, and does it stay right?
//
// Question: time and memory of the solve, standard errors included, by the number of scenes, and the scenes' rms error beside what the
// alignment states. Baseline: none; the time should grow in proportion to the scenes. Chains are simulated from true cameras in lawnmower legs
// (tests/unit/mosaic/align/synthetic.h); no pixel is touched, so that loop closures by content are not part of it.
#include <fmt/format.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <ctime>
#include <vector>

#include "mosaic/align/align.h"
#include "tests/unit/mosaic/align/synthetic.h"

namespace trem::align {
namespace {

Status Measure(int scene_count) {
  SyntheticOptions options;
  options.frame_count = static_cast<int>(scene_count / 0.857);
  options.leg_frames = 400;
  options.position_bias_m = 1.0;
  options.position_white_m = 0.2;
  options.attitude_white_deg = 0.05;
  const SyntheticSortie sortie = MakeSortie(options);
  const auto start = std::chrono::steady_clock::now();
  const std::clock_t cpu_start = std::clock();
  TREM_ASSIGN_OR_RETURN(const AlignSolution solution, Align(sortie.input, {}, nullptr, nullptr));
  const double cpu_s = static_cast<double>(std::clock() - cpu_start) / CLOCKS_PER_SEC;
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  std::vector<Eigen::Vector2d> errors;
  double sigma2 = 0.0;
  for (const AlignedScene& scene : solution.scenes) {
    const Roi& roi = scene.roi_in_scene;
    const Eigen::Vector2d x(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
    errors.push_back(scene.world_from_scene * x - sortie.world_from_scene[scene.window_id] * x);
    mean += errors.back() / static_cast<double>(solution.scenes.size());
    sigma2 += scene.position_sigma * scene.position_sigma / static_cast<double>(solution.scenes.size());
  }
  double relative2 = 0.0;
  for (const Eigen::Vector2d& error : errors) relative2 += (error - mean).squaredNorm() / static_cast<double>(errors.size());
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  fmt::print("| {} | {} | {:.1f} s | {:.1f} s | {} MB | {:.2f} m | {:.2f} px | {:.2f} m |\n", solution.scenes.size(), solution.used_frame_count, cpu_s,
             wall_s, usage.ru_maxrss / 1024, mean.norm(), std::sqrt(relative2) / sortie.gsd_m, std::sqrt(sigma2));
  return {};
}

}  // namespace
}  // namespace trem::align

int main(int argc, char** argv) {
  std::vector<int> scenes = {300, 1000, 3000, 10000};
  CLI::App app("Times the alignment of simulated chains by the number of scenes.", "align_scale");
  app.add_option("--scenes", scenes, "About so many scenes")->check(CLI::Range(10, 100000))->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  fmt::print("| scenes | frames as unknowns | CPU time | time | memory at most | shared error | error without it, rms | stated standard error |\n"
             "| --- | --- | --- | --- | --- | --- | --- | --- |\n");
  for (const int count : scenes) {
    const trem::Status status = trem::align::Measure(count);
    if (status.ok()) continue;
    fmt::print(stderr, "align_scale: {}\n", status.message());
    return 1;
  }
  return 0;
}
