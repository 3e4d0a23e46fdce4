// Questions: how fast does a pixel become a median, beside what else gives one, and how near is that to what the memory allows?
// Baselines, measured in the same run on one core, piece by piece the best of several passes:
//   nth_element  the textbook median of the values of a pixel, gathered from the same planes: no weights, spread, count or source
//   sort         this project's own scalar reference (ReducePixel): weighted, with everything that the vectors give
//   memcpy       of the bytes that a reduction must move: n values, weights and saturations read, five planes written; as they are, no
//                cache holds the planes
// and for whole tiles, resampling included:
//   GDAL         warping every scene with GDAL (cubic) and averaging what comes out, as a VRT over warped scenes does: it gives a mean, no
//                median
// Bytes a pixel: (3 n + 5) 4; of the unweighted median alone (n + 1) 4.
#include <fmt/format.h>
#include <gdal_alg.h>
#include <gdalwarper.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <vector>

#include "mosaic/base/rng.h"
#include "mosaic/composite/reduce_row.h"
#include "mosaic/composite/tile_compositor.h"
#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;

// Time of work(0) ... work(pieces - 1), each piece the best of `trials` passes over all of them: a piece is so short that one of the passes
// finds the core free, however busy the machine, and the passes lie so far apart that the caches hold nothing of the one before.
double BestSeconds(int trials, int pieces, const auto& work) {
  std::vector<double> best(static_cast<std::size_t>(pieces), 1e300);
  for (int trial = 0; trial < trials; ++trial) {
    for (int piece = 0; piece < pieces; ++piece) {
      const auto start = Clock::now();
      work(piece);
      double& least = best[static_cast<std::size_t>(piece)];
      least = std::min(least, std::chrono::duration<double>(Clock::now() - start).count());
    }
  }
  double sum = 0.0;
  for (const double seconds : best) sum += seconds;
  return sum;
}

constexpr int kRowsPerPiece = 2;

struct Planes {
  int width;
  int rows;
  std::vector<Image<float>> value, weight, saturation;
  Image<float> out[5];

  Planes(int views, int side, int row_count) : width(side), rows(row_count) {
    Rng rng({5});
    for (int k = 0; k < views; ++k) {
      value.emplace_back(side, rows);
      weight.emplace_back(side, rows);
      saturation.emplace_back(side, rows);
      for (float& v : value.back().pixels()) v = static_cast<float>(100.0 + 20.0 * rng.Normal());
      for (float& w : weight.back().pixels()) w = static_cast<float>(0.2 + rng.Uniform());
      for (float& s : saturation.back().pixels()) s = static_cast<float>(0.5 + 0.5 * rng.Uniform());
    }
    for (Image<float>& plane : out) plane = Image<float>(side, rows);
  }

  void Reduce(const ReduceOptions& options, int piece) {
    samples_.resize(value.size());
    std::vector<SampleRow>& samples = samples_;
    for (int y = piece * kRowsPerPiece; y < (piece + 1) * kRowsPerPiece; ++y) {
      for (std::size_t k = 0; k < value.size(); ++k) {
        samples[k] = {0, width, value[k].row(y), weight[k].row(y), saturation[k].row(y), 1.0f, static_cast<float>(k)};
      }
      ReduceRow(samples, width, options, {out[0].row(y), out[1].row(y), out[2].row(y), out[3].row(y), out[4].row(y)});
    }
  }

  void NthElement(int piece) {
    std::vector<float> samples(value.size());
    const auto middle = samples.begin() + static_cast<std::ptrdiff_t>(samples.size() / 2);
    for (int y = piece * kRowsPerPiece; y < (piece + 1) * kRowsPerPiece; ++y) {
      for (int x = 0; x < width; ++x) {
        for (std::size_t k = 0; k < value.size(); ++k) samples[k] = value[k].at(x, y);
        std::nth_element(samples.begin(), middle, samples.end());
        out[0].at(x, y) = *middle;
      }
    }
  }

  void Scalar(const MedianOptions& options, int piece) {
    std::vector<WeightedSample> samples(value.size());
    for (int y = piece * kRowsPerPiece; y < (piece + 1) * kRowsPerPiece; ++y) {
      for (int x = 0; x < width; ++x) {
        for (std::size_t k = 0; k < value.size(); ++k) samples[k] = {value[k].at(x, y), weight[k].at(x, y), static_cast<std::uint32_t>(k)};
        const PixelMedian pixel = ReducePixel(samples, options);
        out[0].at(x, y) = pixel.median;
        out[2].at(x, y) = pixel.nmad;
      }
    }
  }

 private:
  std::vector<SampleRow> samples_;
};

// Seconds to copy as many bytes as a reduction of `pieces` pieces moves, in as many pieces.
double CopySeconds(int trials, int pieces, double bytes) {
  const auto half = static_cast<std::size_t>(0.5 * bytes / pieces);
  const std::vector<char> from(half * static_cast<std::size_t>(pieces), 1);
  std::vector<char> to(from.size(), 2);
  return BestSeconds(trials, pieces, [&](int piece) {
    const std::size_t at = half * static_cast<std::size_t>(piece);
    std::memcpy(to.data() + at, from.data() + at, half);
    asm volatile("" : : "r"(to.data()) : "memory");
  });
}

void MedianTable(const std::vector<int>& view_counts, int side, int rows, int trials) {
  fmt::print(
      "megapixels a second on one core, {} x {} px, best of {} (spread, count, position error and source included but in nth_element)\n",
      side, rows, trials);
  fmt::print("{:>6} {:>10} {:>10} {:>10} {:>12} {:>10} {:>14} {:>16}\n", "views", "weighted", "median", "biweight", "nth_element", "sort",
             "x nth_element", "part of memcpy");
  for (const int views : view_counts) {
    Planes planes(views, side, rows);
    const double megapixels = 1e-6 * side * rows;
    const int pieces = rows / kRowsPerPiece;
    ReduceOptions weighted, plain, biweight;
    plain.median.estimator = Estimator::kMedian;
    biweight.median.estimator = Estimator::kBiweight;
    const double weighted_s = BestSeconds(trials, pieces, [&](int piece) { planes.Reduce(weighted, piece); });
    const double plain_s = BestSeconds(trials, pieces, [&](int piece) { planes.Reduce(plain, piece); });
    const double biweight_s = BestSeconds(trials, pieces, [&](int piece) { planes.Reduce(biweight, piece); });
    const double nth_s = BestSeconds(trials, pieces, [&](int piece) { planes.NthElement(piece); });
    const double sort_s = BestSeconds(trials, pieces, [&](int piece) { planes.Scalar(weighted.median, piece); });
    const double bytes = 4.0 * (3.0 * views + 5.0) * side * rows;
    const double copy_s = CopySeconds(trials, pieces, bytes);
    fmt::print("{:>6} {:>10.1f} {:>10.1f} {:>10.1f} {:>12.1f} {:>10.1f} {:>7.1f}, {:>5.1f} {:>9.2f}, {:>5.2f}\n", views,
               megapixels / weighted_s, megapixels / plain_s, megapixels / biweight_s, megapixels / nth_s, megapixels / sort_s,
               nth_s / weighted_s, nth_s / plain_s, copy_s / weighted_s, copy_s / plain_s);
    std::fflush(stdout);
  }
  fmt::print("pairs: of the weighted median and of the plain one\n");
}

struct Tile {
  MosaicGrid grid;
  std::vector<CompositeScene> scenes;
  std::vector<SceneRaster> rasters;

  Tile(int views, int side) {
    grid.crs_wkt.clear();
    grid.width = grid.height = grid.tile_size = side;
    Rng rng({6});
    for (int k = 0; k < views; ++k) {
      CompositeScene scene;
      const double angle = 0.2 * rng.Uniform();
      const int cells = static_cast<int>(1.5 * side);
      scene.window_id = static_cast<std::uint32_t>(k);
      scene.raster_in_scene = {0, 0, cells, cells};
      scene.world_from_scene.matrix << std::cos(angle), -std::sin(angle), -0.1 * side, -std::sin(angle), -std::cos(angle), 0.3 * side, 0, 0,
          1;
      SceneRaster raster{Image<float>(cells, cells), Image<float>(cells, cells, 10.0f), {}, {}, {0, 0, cells, cells}};
      for (float& v : raster.intensity.pixels()) v = static_cast<float>(100.0 + 20.0 * rng.Normal());
      scenes.push_back(scene);
      rasters.push_back(std::move(raster));
    }
  }

  void Compose() const {
    const SceneReader reader = [this](std::size_t i, const Roi& roi) -> Result<SceneRaster> {
      SceneRaster part{Image<float>(roi.width(), roi.height()), Image<float>(roi.width(), roi.height()), {}, {}, roi};
      for (int y = roi.y0; y < roi.y1; ++y) {
        std::copy_n(rasters[i].intensity.row(y) + roi.x0, roi.width(), part.intensity.row(y - roi.y0));
        std::copy_n(rasters[i].information.row(y) + roi.x0, roi.width(), part.information.row(y - roi.y0));
      }
      return part;
    };
    TREM_CHECK(ComposeTile(grid, {0, 0, grid.width, grid.height}, scenes, reader, {}, [](double) { return true; }).ok());
  }

  // Mean of the scenes that GDAL warped onto the tile.
  void GdalAverage() const {
    GDALDriver* memory = GetGDALDriverManager()->GetDriverByName("MEM");
    Image<float> sum(grid.width, grid.height, 0.0f), count(grid.width, grid.height, 0.0f), warped(grid.width, grid.height);
    for (std::size_t i = 0; i < scenes.size(); ++i) {
      const int cells = scenes[i].raster_in_scene.width();
      const GdalDatasetPtr source(memory->Create("", cells, cells, 1, GDT_Float32, nullptr));
      const GdalDatasetPtr target(memory->Create("", grid.width, grid.height, 1, GDT_Float32, nullptr));
      const Eigen::Matrix3d& m = scenes[i].world_from_scene.matrix;
      GeoTransform from = GeoTransformFromAffine({m.topLeftCorner<2, 2>(), m.topRightCorner<2, 1>()}), to = GeoTransformFromGrid(grid);
      source->SetGeoTransform(from.data());
      target->SetGeoTransform(to.data());
      auto* pixels = const_cast<float*>(rasters[i].intensity.pixels().data());
      TREM_CHECK(source->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, cells, cells, pixels, cells, cells, GDT_Float32, 0, 0, nullptr) ==
                 CE_None);
      target->GetRasterBand(1)->SetNoDataValue(-1e6);
      target->GetRasterBand(1)->Fill(-1e6);
      TREM_CHECK(GDALReprojectImage(source.get(), nullptr, target.get(), nullptr, GRA_Cubic, 0, 0.0, nullptr, nullptr, nullptr) == CE_None);
      TREM_CHECK(target->GetRasterBand(1)->RasterIO(GF_Read, 0, 0, grid.width, grid.height, warped.pixels().data(), grid.width, grid.height,
                                                    GDT_Float32, 0, 0, nullptr) == CE_None);
      for (std::size_t p = 0; p < sum.pixels().size(); ++p) {
        const bool seen = warped.pixels()[p] > -1e5f;
        sum.pixels()[p] += seen ? warped.pixels()[p] : 0.0f;
        count.pixels()[p] += seen ? 1.0f : 0.0f;
      }
    }
    for (std::size_t p = 0; p < sum.pixels().size(); ++p) sum.pixels()[p] /= std::max(count.pixels()[p], 1.0f);
  }
};

void TileTable(const std::vector<int>& view_counts, int side, int trials) {
  fmt::print("\nwhole tiles of {} x {} px with resampling, megapixels x views a second on one core, best of {}\n", side, side, trials);
  fmt::print("{:>6} {:>12} {:>20} {:>8}\n", "views", "compositor", "GDAL warp + average", "ratio");
  for (const int views : view_counts) {
    const Tile tile(views, side);
    const double samples = 1e-6 * side * side * views;
    const double own_s = BestSeconds(trials, 1, [&](int) { tile.Compose(); });
    const double gdal_s = BestSeconds(trials, 1, [&](int) { tile.GdalAverage(); });
    fmt::print("{:>6} {:>12.2f} {:>20.2f} {:>8.2f}\n", views, samples / own_s, samples / gdal_s, gdal_s / own_s);
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  std::vector<int> views = {3, 5, 8, 16, 32};
  int side = 2048, rows = 1024, trials = 7, tile_side = 512;
  CLI::App app("Speed of the median, beside its peers");
  app.add_option("--views", views, "Scenes over a pixel")->check(CLI::Range(1, 64));
  app.add_option("--side", side, "Pixels of a row")->check(CLI::Range(16, 100000));
  app.add_option("--rows", rows, "Rows; even")->check(CLI::Range(2, 100000));
  app.add_option("--trials", trials, "Best of")->check(CLI::Range(1, 1000));
  app.add_option("--tile", tile_side, "Side of the tiles that are resampled; 0: none")->check(CLI::Range(0, 4096));
  CLI11_PARSE(app, argc, argv);
  trem::InitialiseGdal();
  trem::MedianTable(views, side, rows, trials);
  if (tile_side > 0) trem::TileTable(views, tile_side, trials);
  return 0;
}
