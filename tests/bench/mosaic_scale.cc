// Question: do memory and time of compositing and export stay what they should be as a mosaic grows?
// Method: synthetic scenes of 603 x 603 cells on a raster over a square mosaic, stored with the messages that ENHANCE and ALIGN write;
// every COMPOSITE task and the EXPORT run by the workers' own code in child processes, --workers at a time, each child taking tile after
// tile as a worker does. Peak memory is what the kernel says of each child; times are the children's processor time, so that other work on
// the machine does not count. Baselines are the smaller mosaics of the same run: memory should not grow, and time for a pixel and scene
// over it should be the same.
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

constexpr int kSceneSide = 603;
constexpr double kGsd = 0.1;
constexpr double kOriginX = 500000.0, kOriginY = 5000000.0;

// What children of one stage needed.
struct Usage {
  double cpu_s = 0.0;
  double elapsed_s = 0.0;
  double peak_mb = 0.0;  // Of the largest child.
};

struct Job {
  fs::path store_path;
  v1::ArtefactRef alignment, manifest;
  std::vector<v1::ArtefactRef> windows;
  std::vector<std::vector<std::uint32_t>> windows_of_tile;
  double overlap = 0.0;
};

double CpuSeconds(const rusage& usage) {
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

// Runs work(0) ... work(count - 1) in one child process each.
Usage InChildren(int count, const std::function<void(int)>& work) {
  Usage usage;
  const auto start = std::chrono::steady_clock::now();
  std::fflush(nullptr);
  for (int i = 0; i < count; ++i) {
    const pid_t pid = ::fork();
    TREM_CHECK(pid >= 0);
    if (pid != 0) continue;
    work(i);
    std::fflush(nullptr);
    ::_exit(0);
  }
  for (int i = 0; i < count; ++i) {
    rusage child{};
    int status = 0;
    TREM_CHECK(::wait4(-1, &status, 0, &child) > 0);
    TREM_CHECK_MSG(WIFEXITED(status) && WEXITSTATUS(status) == 0, "a child failed");
    usage.cpu_s += CpuSeconds(child);
    usage.peak_mb = std::max(usage.peak_mb, static_cast<double>(child.ru_maxrss) / 1024.0);
  }
  usage.elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return usage;
}

double Ground(double x, double y) { return 110.0 + 40.0 * std::sin(x / 1.7) * std::cos(y / 1.3) + 20.0 * std::sin((x + 2.0 * y) / 9.0); }

// Scene `index` in column `column` and row `row` of the raster, turned a little.
Homography WorldFromScene(int column, int row, double step_px, std::uint64_t index) {
  Rng rng({77, index});
  const double angle = 0.04 * (rng.Uniform() - 0.5), c = kGsd * std::cos(angle), s = kGsd * std::sin(angle);
  Homography map;
  map.matrix << c, -s, kOriginX + kGsd * (column * step_px + rng.Uniform()), -s, -c, kOriginY - kGsd * (row * step_px + rng.Uniform()), 0.0,
      0.0, 1.0;
  return map;
}

v1::ArtefactRef StoreScene(const ArtefactStore& store, const Homography& world_from_scene, std::uint64_t index) {
  SceneRaster raster{Image<float>(kSceneSide, kSceneSide), Image<float>(kSceneSide, kSceneSide, 12.0f), {}, {}, {}};
  Rng rng({78, index});
  for (int y = 0; y < kSceneSide; ++y) {
    for (int x = 0; x < kSceneSide; ++x) {
      const Eigen::Vector2d at = world_from_scene * Eigen::Vector2d(x, y);
      // To a sixteenth of a level, so that files are as large as those of real scenes.
      raster.intensity.at(x, y) = static_cast<float>(std::round(16.0 * (Ground(at.x(), at.y()) + 0.5 * rng.Uniform())) / 16.0);
    }
  }
  const fs::path path = store.NewTemporaryPath(".tif");
  TREM_CHECK(WriteSceneRaster(path, raster).ok());
  return ToProto(*store.PutFile("scene.tif", path));
}

Job MakeJob(const fs::path& folder, int side, double step_px) {
  Job job;
  job.store_path = folder;
  const ArtefactStore store = *ArtefactStore::Open(folder);
  v1::Alignment alignment;
  MosaicGrid grid;
  grid.crs_wkt = *CrsWkt("EPSG:32630");
  grid.origin_x = kOriginX;
  grid.origin_y = kOriginY;
  grid.gsd = kGsd;
  grid.width = grid.height = side;
  grid.tile_size = 512;
  *alignment.mutable_grid() = ToProto(grid);
  alignment.set_georeferenced(true);
  alignment.set_piece_count(1);
  job.windows_of_tile.resize(static_cast<std::size_t>(grid.tile_count()));
  const int across = static_cast<int>(std::ceil(side / step_px));
  for (int row = 0; row < across; ++row) {
    for (int column = 0; column < across; ++column) {
      const auto id = static_cast<std::uint32_t>(row * across + column);
      const Homography world_from_scene = WorldFromScene(column, row, step_px, id);
      v1::WindowResult window;
      window.set_window_id(id);
      v1::EmittedScene* scene = window.add_segments()->add_scenes();
      *scene->mutable_raster() = StoreScene(store, world_from_scene, id);
      *scene->mutable_roi_in_scene() = ToProto(Roi{0, 0, kSceneSide, kSceneSide});
      job.windows.push_back(*PutProtoArtefact(store, "window.pb", window));
      v1::AlignedScene* aligned = alignment.add_scenes();
      aligned->set_window_id(id);
      ToProto(world_from_scene, aligned->mutable_world_from_scene());
      aligned->set_gain(1.0);
      aligned->set_position_sigma(0.1);
      // The scene reaches this far at most, turned as it is.
      const int reach = kSceneSide + 30, x0 = static_cast<int>(column * step_px), y0 = static_cast<int>(row * step_px);
      for (int ty = std::max(y0 - 30, 0) / 512; ty <= std::min(y0 + reach, side - 1) / 512; ++ty) {
        for (int tx = std::max(x0 - 30, 0) / 512; tx <= std::min(x0 + reach, side - 1) / 512; ++tx) {
          job.windows_of_tile[static_cast<std::size_t>(ty * grid.tile_columns() + tx)].push_back(id);
        }
      }
    }
  }
  v1::SortieManifest manifest;
  manifest.set_source_path("/synthetic");
  manifest.set_grey_scale(1.0);
  manifest.set_grey_max(255.0);
  job.alignment = *PutProtoArtefact(store, "alignment.pb", alignment);
  job.manifest = *PutProtoArtefact(store, "manifest.pb", manifest);
  job.overlap = static_cast<double>(across) * across * kSceneSide * kSceneSide / (static_cast<double>(side) * side);
  return job;
}

TaskContext ContextOf(const ArtefactStore& store) {
  TaskContext context;
  context.store = &store;
  context.progress = [](double) { return true; };
  return context;
}

// Runs the tiles index, index + workers, ... and writes the refs of what it made to `list`.
void CompositeTiles(const Job& job, int index, int workers, const fs::path& list) {
  const ArtefactStore store = *ArtefactStore::Open(job.store_path);
  const TaskContext context = ContextOf(store);
  v1::TaskResult made;
  for (std::size_t tile = static_cast<std::size_t>(index); tile < job.windows_of_tile.size(); tile += static_cast<std::size_t>(workers)) {
    v1::TaskSpec spec;
    spec.set_kind(v1::COMPOSITE);
    spec.mutable_sortie()->mutable_tre()->set_ratio(3);
    spec.mutable_composite()->set_tile_index(static_cast<std::uint32_t>(tile));
    *spec.add_inputs() = job.alignment;
    for (const std::uint32_t id : job.windows_of_tile[tile]) *spec.add_inputs() = job.windows[id];
    const auto result = RunTask(spec, context);
    TREM_CHECK_MSG(result.ok(), result.status().message());
    *made.add_outputs() = result->outputs(0);
  }
  FILE* file = std::fopen(list.c_str(), "wb");
  const std::string bytes = made.SerializeAsString();
  TREM_CHECK(file != nullptr && std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size() && std::fclose(file) == 0);
}

v1::TaskResult ReadResult(const fs::path& path) {
  FILE* file = std::fopen(path.c_str(), "rb");
  TREM_CHECK(file != nullptr);
  std::string bytes(fs::file_size(path), '\0');
  TREM_CHECK(std::fread(bytes.data(), 1, bytes.size(), file) == bytes.size());
  std::fclose(file);
  v1::TaskResult result;
  TREM_CHECK(result.ParseFromString(bytes));
  return result;
}

void Export(const Job& job, const std::vector<v1::ArtefactRef>& tiles, const fs::path& list) {
  const ArtefactStore store = *ArtefactStore::Open(job.store_path);
  v1::TaskSpec spec;
  spec.set_kind(v1::EXPORT);
  spec.mutable_sortie()->set_name("synthetic");
  spec.mutable_sortie()->mutable_tre()->set_ratio(3);
  *spec.add_inputs() = job.alignment;
  *spec.add_inputs() = job.manifest;
  for (const v1::ArtefactRef& window : job.windows) *spec.add_inputs() = window;
  for (const v1::ArtefactRef& tile : tiles) *spec.add_inputs() = tile;
  const auto result = RunTask(spec, ContextOf(store));
  TREM_CHECK_MSG(result.ok(), result.status().message());
  FILE* file = std::fopen(list.c_str(), "wb");
  const std::string bytes = result->SerializeAsString();
  TREM_CHECK(file != nullptr && std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size() && std::fclose(file) == 0);
}

void Measure(const fs::path& folder, int side, double step_px, int workers, bool keep) {
  const fs::path work = folder / ("mosaic_" + std::to_string(side));
  fs::create_directories(work);
  const Job job = MakeJob(work / "store", side, step_px);
  const Usage composite = InChildren(workers, [&](int i) { CompositeTiles(job, i, workers, work / ("tiles_" + std::to_string(i))); });
  std::vector<v1::ArtefactRef> tiles(job.windows_of_tile.size());
  for (int i = 0; i < workers; ++i) {
    const v1::TaskResult made = ReadResult(work / ("tiles_" + std::to_string(i)));
    for (int k = 0; k < made.outputs_size(); ++k) tiles[static_cast<std::size_t>(i + k * workers)] = made.outputs(k);
  }
  const Usage exported = InChildren(1, [&](int) { Export(job, tiles, work / "export"); });
  const double samples = 1e-6 * job.overlap * side * side;
  fmt::print("{:>7} {:>7} {:>8.2f} | {:>9.1f} {:>9.1f} {:>12.3f} {:>9.0f} | {:>9.1f} {:>9.1f} {:>12.3f} {:>9.0f}\n", side,
             job.windows.size(), job.overlap, composite.cpu_s, composite.elapsed_s, composite.cpu_s / samples, composite.peak_mb,
             exported.cpu_s, exported.elapsed_s, exported.cpu_s / (1e-6 * side * side), exported.peak_mb);
  std::fflush(stdout);
  if (!keep) {
    fs::remove_all(work);
    return;
  }
  const ArtefactStore store = *ArtefactStore::Open(job.store_path);
  const v1::TaskResult files = ReadResult(work / "export");
  for (const v1::ArtefactRef& output : files.outputs()) {
    fs::copy_file(*store.Locate(FromProto(output)), work / output.name(), fs::copy_options::overwrite_existing);
  }
  fs::remove_all(work / "store");
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  std::vector<int> sides = {2500, 5000, 10000};
  double step_px = 430.0;
  int workers = 2;
  bool keep = false;
  std::string folder = "mosaic_scale";
  CLI::App app("Memory and time of compositing and export as a mosaic grows");
  app.add_option("--sides", sides, "Sides of the mosaics, pixels")->check(CLI::Range(600, 100000));
  app.add_option("--step", step_px, "Distance of scenes, mosaic pixels; smaller: more overlap")->check(CLI::Range(60.0, 600.0));
  app.add_option("--workers", workers, "Children at a time")->check(CLI::Range(1, 64));
  app.add_option("--folder", folder, "Where files are made; about 6 bytes a pixel and scene over it, 40 a pixel");
  app.add_flag("--keep", keep, "Keep the mosaics");
  CLI11_PARSE(app, argc, argv);
  fmt::print("{:>25} | {:^42} | {:^42}\n", "", "COMPOSITE", "EXPORT");
  fmt::print("{:>7} {:>7} {:>8} | {:>9} {:>9} {:>12} {:>9} | {:>9} {:>9} {:>12} {:>9}\n", "side", "scenes", "overlap", "cpu s", "elapsed s",
             "us/px/scene", "peak MB", "cpu s", "elapsed s", "us/px", "peak MB");
  std::filesystem::create_directories(folder);
  for (const int side : sides) trem::Measure(folder, side, step_px, workers, keep);
  return 0;
}
