// The soak as a command: `build/release/bin/trem_soak --seed 7`. Exit code 0: the mosaic is the undisturbed one, byte for byte.
#include <CLI/CLI.hpp>
#include <chrono>
#include <iostream>

#include "tests/e2e/soak.h"

int main(int argc, char** argv) {
  trem::testing::SoakOptions options;
  CLI::App app("Kills, stops, starves, cuts off and lies to the processes of a job, and compares its mosaic with an undisturbed run.",
               "trem_soak");
  app.add_option("--seed", options.seed, "Which disturbances, and when")->capture_default_str();
  auto* frames =
      app.add_option("--frames", options.frame_count, "Frames of the simulated sortie; with --kills 24 a kill")->capture_default_str();
  app.add_option("--workers", options.worker_count, "Worker processes")->check(CLI::Range(1, 64))->capture_default_str();
  app.add_option("--disturbances", options.disturbance_count, "Disturbances at most; fewer when the job ends before")
      ->capture_default_str();
  app.add_option("--kills", options.kill_count,
                 "Goes on until so many processes were killed, however many disturbances that takes (0: --disturbances says); a job that "
                 "ends before fails")
      ->check(CLI::Range(0, 10'000))
      ->capture_default_str();
  auto* pause = app.add_option("--pause-ms", options.pause_ms_max, "Time between two disturbances, about; with --kills 100")
                    ->check(CLI::Range(8, 60'000))
                    ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  // So that the job lasts.
  if (options.kill_count > 0 && frames->count() == 0) options.frame_count = 24 * options.kill_count;
  if (options.kill_count > 0 && pause->count() == 0) options.pause_ms_max = 100;
  options.tell = [](const std::string& progress) { std::cerr << progress << std::endl; };
  const auto start = std::chrono::steady_clock::now();
  trem::testing::Soak soak(options);
  const std::vector<std::string> faults = soak.Run();
  const auto elapsed = std::chrono::duration_cast<std::chrono::seconds>(std::chrono::steady_clock::now() - start);
  std::cout << "seed " << options.seed << ": " << soak.task_count() << " tasks on " << options.worker_count << " workers, "
            << elapsed.count() << " s; " << soak.kill_count() << " kills; the job took " << soak.disturbed_time().count() / 1000.0
            << " s, and in peace by two workers " << soak.peaceful_time().count() / 1000.0 << " s\n";
  for (const auto& [what, count] : soak.counts()) std::cout << "  " << what << ": " << count << "\n";
  if (!soak.can_fill_disk()) std::cout << "  the disk was not filled: no file system can be mounted here\n";
  if (!soak.why_no_link().empty()) std::cout << "  no link was cut: no network namespace can be made here: " << soak.why_no_link() << "\n";
  for (const std::string& fault : faults) std::cout << "FAILED: " << fault << "\n";
  if (faults.empty()) std::cout << "the mosaic and its siblings are byte-identical to the undisturbed run\n";
  return faults.empty() ? 0 : 1;
}
