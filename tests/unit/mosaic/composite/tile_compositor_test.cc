// Goal: a tile is the weighted median of the scenes that reach it; any tiling, order of scenes and memory budget gives the same pixels.
// Method: scenes cut from one analytic ground under random homographies, compared with the ground, with a naive whole-image median, and
// with themselves under other tilings.
#include "mosaic/composite/tile_compositor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mosaic/base/rng.h"
#include "mosaic/composite/warp.h"
#include "mosaic/geometry/footprint.h"

namespace trem {
namespace {

double Ground(double x, double y) { return 120.0 + 50.0 * std::sin(x / 9.0) * std::cos(y / 7.0) + 10.0 * std::sin((x + y) / 23.0); }

MosaicGrid Grid(int width, int height, int tile_size) {
  MosaicGrid grid;
  grid.origin_x = 5000.0;
  grid.origin_y = 8000.0;
  grid.gsd = 0.5;
  grid.width = width;
  grid.height = height;
  grid.tile_size = tile_size;
  return grid;
}

struct World {
  MosaicGrid grid;
  std::vector<CompositeScene> scenes;
  std::vector<SceneRaster> rasters;

  SceneReader Reader() const {
    return [this](std::size_t index, const Roi& roi) -> Result<SceneRaster> {
      const SceneRaster& whole = rasters[index];
      if (!whole.roi.Contains(roi)) return Corrupt("read outside of the raster");
      SceneRaster part{Image<float>(roi.width(), roi.height()), Image<float>(roi.width(), roi.height()), {}, {}, roi};
      for (int y = 0; y < roi.height(); ++y) {
        for (int x = 0; x < roi.width(); ++x) {
          part.intensity.at(x, y) = whole.intensity.at(x + roi.x0, y + roi.y0);
          part.information.at(x, y) = whole.information.at(x + roi.x0, y + roi.y0);
        }
      }
      return part;
    };
  }
};

// Scenes of 120 x 100 cells scattered over the grid, with their own gain and offset (undone by the alignment) and holes.
World MakeWorld(int scene_count, std::uint64_t seed, bool with_holes) {
  World world;
  world.grid = Grid(200, 150, 64);
  Rng rng({seed});
  for (int i = 0; i < scene_count; ++i) {
    CompositeScene scene;
    scene.window_id = static_cast<std::uint32_t>(10 + i / 2);
    scene.scene_id = static_cast<std::uint32_t>(i % 2);
    scene.raster_in_scene = {-7, 3, 113, 103};
    const double angle = 0.6 * (rng.Uniform() - 0.5), scale = 0.5 * (0.8 + 0.3 * rng.Uniform());
    const double cx = 5000.0 + 100.0 * rng.Uniform(), cy = 8000.0 - 75.0 * rng.Uniform();
    Homography shape;  // y flips: rows go down, the world goes up.
    shape.matrix << scale * std::cos(angle), -scale * std::sin(angle), cx, -scale * std::sin(angle), -scale * std::cos(angle), cy, 0.0, 0.0,
        1.0;
    Homography centre;
    centre.matrix << 1.0, 0.0, -53.0, 0.0, 1.0, -53.0, 3e-4 * (rng.Uniform() - 0.5), 3e-4 * (rng.Uniform() - 0.5), 1.0;
    scene.world_from_scene = shape * centre;
    if (i % 3 == 0) scene.world_from_scene.matrix *= -2.0;  // A homography's sign and scale mean nothing.
    scene.gain = 0.8 + 0.4 * rng.Uniform();
    scene.offset = 20.0 * (rng.Uniform() - 0.5);
    scene.position_sigma = 0.1 + 0.1 * i;
    SceneRaster raster{Image<float>(120, 100), Image<float>(120, 100), {}, {}, {0, 0, 120, 100}};
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 120; ++x) {
        const Eigen::Vector2d at = scene.world_from_scene * Eigen::Vector2d(x - 7, y + 3);
        raster.intensity.at(x, y) = static_cast<float>((Ground(at.x(), at.y()) - scene.offset) / scene.gain);
        raster.information.at(x, y) = with_holes && rng.Uniform() < 0.002 ? 0.0f : static_cast<float>(0.5 + 10.0 * rng.Uniform());
      }
    }
    world.scenes.push_back(scene);
    world.rasters.push_back(std::move(raster));
  }
  return world;
}

CompositeOptions Options() {
  CompositeOptions options;
  options.taper_cells = 15.0;
  return options;
}

const std::function<bool(double)> kGoOn = [](double) { return true; };

CompositeTile Compose(const World& world, const Roi& roi, const CompositeOptions& options) {
  Result<CompositeTile> tile = ComposeTile(world.grid, roi, world.scenes, world.Reader(), options, kGoOn);
  EXPECT_TRUE(tile.ok()) << tile.status().message();
  return std::move(tile).value();
}

bool SameBits(float a, float b) { return std::memcmp(&a, &b, sizeof(a)) == 0; }

TEST(TileCompositor, ReproducesTheGroundAfterBalancing) {
  const World world = MakeWorld(24, 1, false);
  const CompositeTile tile = Compose(world, {0, 0, 200, 150}, Options());
  int covered = 0;
  for (int y = 0; y < 150; ++y) {
    for (int x = 0; x < 200; ++x) {
      ASSERT_EQ(std::isnan(tile.median.at(x, y)), tile.count.at(x, y) == 0.0f);
      ASSERT_EQ(tile.source.at(x, y) == kNoSource, tile.count.at(x, y) == 0.0f);
      ASSERT_EQ(std::isnan(tile.nmad.at(x, y)), tile.count.at(x, y) < 2.0f);
      if (tile.count.at(x, y) == 0.0f) continue;
      const Eigen::Vector2d at = world.grid.WorldFromPixel({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_NEAR(tile.median.at(x, y), Ground(at.x(), at.y()), 0.3);
      ++covered;
    }
  }
  EXPECT_GT(covered, 20000);
}

TEST(TileCompositor, TilesEqualTheWholeImageBitForBit) {
  const World world = MakeWorld(24, 2, true);
  const CompositeTile whole = Compose(world, {0, 0, 200, 150}, Options());
  for (int index = 0; index < world.grid.tile_count(); ++index) {
    const Roi roi = world.grid.TileRoi(index);
    const CompositeTile tile = Compose(world, roi, Options());
    for (int y = roi.y0; y < roi.y1; ++y) {
      for (int x = roi.x0; x < roi.x1; ++x) {
        const int column = x - roi.x0, row = y - roi.y0;
        ASSERT_TRUE(SameBits(tile.median.at(column, row), whole.median.at(x, y))) << x << " " << y;
        ASSERT_TRUE(SameBits(tile.nmad.at(column, row), whole.nmad.at(x, y))) << x << " " << y;
        ASSERT_TRUE(SameBits(tile.position_sigma.at(column, row), whole.position_sigma.at(x, y))) << x << " " << y;
        ASSERT_EQ(tile.count.at(column, row), whole.count.at(x, y));
        ASSERT_EQ(tile.source.at(column, row), whole.source.at(x, y));
      }
    }
  }
}

// Shifts reach beyond what the homography alone says of a scene's footprint: any tiling must still find, read and place the same cells.
TEST(TileCompositor, TilesEqualTheWholeImageOverHills) {
  World world = MakeWorld(24, 2, true);
  for (std::size_t i = 0; i < world.scenes.size(); ++i) {
    CompositeScene& scene = world.scenes[i];
    scene.shifts = CellShifts::Over({-7.0, 3.0}, {112.0, 102.0}, 24.0, Eigen::Vector2d::Zero());
    for (std::size_t k = 0; k < scene.shifts.values.size(); ++k) {
      const double phase = static_cast<double>(3 * i + k);
      scene.shifts.values[k] = {9.0 * std::sin(phase), 7.0 * std::cos(0.7 * phase)};
    }
  }
  const CompositeTile whole = Compose(world, {0, 0, 200, 150}, Options());
  const Result<std::vector<std::vector<std::size_t>>> by_tile = ScenesByTile(world.grid, world.scenes);
  ASSERT_TRUE(by_tile.ok());
  for (int t = 0; t < world.grid.tile_count(); ++t) {
    const Roi roi = world.grid.TileRoi(t);
    EXPECT_EQ((*by_tile)[static_cast<std::size_t>(t)].size(), ContributingScenes(world.grid, roi, world.scenes)->size());
    const CompositeTile tile = Compose(world, roi, Options());
    for (int y = 0; y < roi.height(); ++y) {
      for (int x = 0; x < roi.width(); ++x)
        ASSERT_TRUE(SameBits(tile.median.at(x, y), whole.median.at(x + roi.x0, y + roi.y0))) << t << " " << x << " " << y;
    }
  }
}

TEST(TileCompositor, NeitherTheOrderOfScenesNorTheMemoryBudgetChangesAnything) {
  World world = MakeWorld(16, 3, true);
  const CompositeTile expected = Compose(world, {0, 0, 200, 150}, Options());
  CompositeOptions tight = Options();
  tight.stack_bytes_max = 40000;  // A few rows at a time.
  const CompositeTile banded = Compose(world, {0, 0, 200, 150}, tight);
  std::reverse(world.scenes.begin(), world.scenes.end());
  std::reverse(world.rasters.begin(), world.rasters.end());
  const CompositeTile reversed = Compose(world, {0, 0, 200, 150}, Options());
  for (const CompositeTile* other : {&banded, &reversed}) {
    EXPECT_EQ(0, std::memcmp(expected.median.pixels().data(), other->median.pixels().data(), expected.median.pixels().size_bytes()));
    EXPECT_EQ(0, std::memcmp(expected.nmad.pixels().data(), other->nmad.pixels().data(), expected.nmad.pixels().size_bytes()));
    EXPECT_EQ(0, std::memcmp(expected.source.pixels().data(), other->source.pixels().data(), expected.source.pixels().size_bytes()));
  }
}

TEST(TileCompositor, EqualsANaiveMedianOverWholeWarpedScenes) {
  // The rule, written down a second time without bands, footprints or partial reads.
  const World world = MakeWorld(14, 4, true);
  const CompositeOptions options = Options();
  const Roi all{0, 0, 200, 150};
  const CompositeTile tile = Compose(world, all, options);
  std::vector<WarpedScene> warped;
  for (std::size_t i = 0; i < world.scenes.size(); ++i) {
    const CompositeScene& scene = world.scenes[i];
    Homography pixel_from_world;
    pixel_from_world.matrix << 2.0, 0.0, -10000.0, 0.0, -2.0, 16000.0, 0.0, 0.0, 1.0;
    const Homography mosaic_from_scene = *NormalisedAt(pixel_from_world * scene.world_from_scene, {52.5, 52.5});
    SceneRaster copy = world.rasters[i];
    warped.push_back(WarpScene(*PrepareWarp(std::move(copy), scene.raster_in_scene), mosaic_from_scene.Inverse(), all));
  }
  for (int y = 0; y < 150; ++y) {
    for (int x = 0; x < 200; ++x) {
      double best = 0.0;
      for (const WarpedScene& w : warped) {
        if (!std::isnan(w.intensity.at(x, y))) best = std::max(best, w.information.at(x, y) / (w.information.at(x, y) + 2.0));
      }
      std::vector<WeightedSample> samples;
      for (std::size_t i = 0; i < warped.size(); ++i) {
        if (std::isnan(warped[i].intensity.at(x, y))) continue;
        const double n = warped[i].information.at(x, y);
        const double s = n / (n + 2.0);
        if (n < 2.0 && s < 0.5 * best) continue;
        const double t = std::min(warped[i].border_distance.at(x, y) / 15.0, 1.0);
        samples.push_back({static_cast<float>(world.scenes[i].gain * warped[i].intensity.at(x, y) + world.scenes[i].offset),
                           static_cast<float>(s * std::max(t * t * (3.0 - 2.0 * t), 1e-3) * std::min(1.0f, warped[i].detail.at(x, y))),
                           static_cast<std::uint32_t>(i)});
      }
      ASSERT_EQ(tile.count.at(x, y), static_cast<float>(samples.size()));
      if (samples.empty()) continue;
      ASSERT_NEAR(tile.median.at(x, y), ReducePixel(samples, options.median).median, 1e-4);
    }
  }
}

TEST(TileCompositor, ScenesByTileAreThoseThatContributeToEachTile) {
  const World world = MakeWorld(24, 9, false);
  const auto tiles = ScenesByTile(world.grid, world.scenes);
  ASSERT_TRUE(tiles.ok()) << tiles.status().message();
  ASSERT_EQ(tiles->size(), static_cast<std::size_t>(world.grid.tile_count()));
  std::size_t pairs = 0;
  for (int index = 0; index < world.grid.tile_count(); ++index) {
    std::vector<std::size_t> expected = *ContributingScenes(world.grid, world.grid.TileRoi(index), world.scenes);
    std::sort(expected.begin(), expected.end());
    EXPECT_EQ((*tiles)[static_cast<std::size_t>(index)], expected) << "tile " << index;
    pairs += expected.size();
  }
  EXPECT_LT(pairs, world.scenes.size() * tiles->size());
}

// One ground seen by two scenes side by side that overlap, the right one after an exposure change that the alignment undid but for an
// error of gain and offset.
World TwoLegs(double gain_error, double offset_error) {
  World world;
  world.grid = Grid(300, 60, 64);
  for (std::uint32_t i = 0; i < 2; ++i) {
    CompositeScene scene;
    scene.window_id = i;
    scene.raster_in_scene = {0, 0, 190, 60};
    const double x0 = 5000.0 + 0.5 * 110.0 * i;
    scene.world_from_scene.matrix << 0.5, 0.0, x0, 0.0, -0.5, 8000.0, 0.0, 0.0, 1.0;
    scene.gain = i == 0 ? 1.0 : 1.6;
    scene.offset = i == 0 ? 0.0 : -12.0;
    SceneRaster raster{Image<float>(190, 60), Image<float>(190, 60, 8.0f), {}, {}, {0, 0, 190, 60}};
    for (int y = 0; y < 60; ++y) {
      for (int x = 0; x < 190; ++x) {
        double balanced = Ground(x0 + 0.5 * x, 8000.0 - 0.5 * y);
        if (i == 1) balanced = (1.0 + gain_error) * balanced + offset_error;
        raster.intensity.at(x, y) = static_cast<float>((balanced - scene.offset) / scene.gain);
      }
    }
    world.scenes.push_back(scene);
    world.rasters.push_back(std::move(raster));
  }
  return world;
}

TEST(TileCompositor, LegsOfDifferentExposureMeetWithoutASeam) {
  // What balancing leaves over (1 %, 1 level) must fade across the overlap: nowhere may a neighbour differ by more than the ground does and
  // a tenth of the leftover. For every estimator that promises it.
  for (const Estimator estimator : {Estimator::kWeightedMedian, Estimator::kBiweight}) {
    CompositeOptions options;
    options.taper_cells = 40.0;
    options.median.estimator = estimator;
    const CompositeTile clean = Compose(TwoLegs(0.0, 0.0), {0, 0, 300, 60}, options);
    const CompositeTile tile = Compose(TwoLegs(0.01, 1.0), {0, 0, 300, 60}, options);
    const double leftover = 1.0 + 0.01 * 180.0;
    double most = 0.0;
    for (int y = 20; y < 40; ++y) {
      for (int x = 0; x + 1 < 300; ++x) {
        if (tile.count.at(x, y) == 0.0f || tile.count.at(x + 1, y) == 0.0f) continue;
        const double step = (tile.median.at(x + 1, y) - clean.median.at(x + 1, y)) - (tile.median.at(x, y) - clean.median.at(x, y));
        most = std::max(most, std::abs(step));
      }
    }
    EXPECT_LT(most, 0.1 * leftover) << "estimator " << static_cast<int>(estimator);
  }
}

TEST(TileCompositor, TheFinerOfTwoViewsCountsForMore) {
  // Two scenes of the same ground and information, one sampled four times as coarsely in one direction, with another level each.
  World world;
  world.grid = Grid(60, 60, 64);
  for (std::uint32_t i = 0; i < 2; ++i) {
    const int height = i == 0 ? 60 : 15;
    CompositeScene scene;
    scene.window_id = i;
    scene.raster_in_scene = {0, 0, 60, height};
    scene.world_from_scene.matrix << 0.5, 0.0, 5000.0, 0.0, i == 0 ? -0.5 : -2.0, 8000.0, 0.0, 0.0, 1.0;
    world.scenes.push_back(scene);
    world.rasters.push_back(
        {Image<float>(60, height, i == 0 ? 10.0f : 90.0f), Image<float>(60, height, 20.0f), {}, {}, {0, 0, 60, height}});
  }
  CompositeOptions options = Options();
  options.taper_cells = 0.0;
  EXPECT_NEAR(Compose(world, {0, 0, 60, 60}, options).median.at(30, 30), 10.0f, 1e-3);
  options.weigh_detail = false;
  EXPECT_NEAR(Compose(world, {0, 0, 60, 60}, options).median.at(30, 30), 50.0f, 1e-3);
}

TEST(TileCompositor, PoorlySeenGroundIsUsedOnlyWhereNothingBetterCoversIt) {
  World world;
  world.grid = Grid(40, 40, 64);
  for (std::uint32_t i = 0; i < 2; ++i) {
    CompositeScene scene;
    scene.window_id = i;
    scene.raster_in_scene = {0, 0, 40, i == 0 ? 40 : 20};
    scene.world_from_scene.matrix << 0.5, 0.0, 5000.0, 0.0, -0.5, 8000.0, 0.0, 0.0, 1.0;
    const int height = scene.raster_in_scene.height();
    world.scenes.push_back(scene);
    world.rasters.push_back(
        {Image<float>(40, height, i == 0 ? 10.0f : 90.0f), Image<float>(40, height, i == 0 ? 0.1f : 20.0f), {}, {}, {0, 0, 40, height}});
  }
  CompositeOptions options = Options();
  options.taper_cells = 0.0;
  const CompositeTile tile = Compose(world, {0, 0, 40, 40}, options);
  EXPECT_EQ(tile.median.at(20, 10), 90.0f);
  EXPECT_EQ(tile.count.at(20, 10), 1.0f);
  EXPECT_EQ(tile.median.at(20, 30), 10.0f);
  EXPECT_EQ(tile.source.at(20, 30), 0.0f);
}

TEST(TileCompositor, ATileThatNoSceneCoversIsEmptyAndReadsNothing) {
  World world = MakeWorld(4, 5, false);
  world.grid.origin_x += 1e5;
  const SceneReader never = [](std::size_t, const Roi&) -> Result<SceneRaster> { return Failed("nothing should be read"); };
  const auto tile = ComposeTile(world.grid, {0, 0, 64, 64}, world.scenes, never, Options(), kGoOn);
  ASSERT_TRUE(tile.ok()) << tile.status().message();
  for (const float count : tile->count.pixels()) ASSERT_EQ(count, 0.0f);
  for (const float median : tile->median.pixels()) ASSERT_TRUE(std::isnan(median));
}

TEST(TileCompositor, AMoverInOneOfThreeScenesLeavesNoGhost) {
  World world = MakeWorld(1, 6, false);
  for (std::uint32_t i = 1; i < 3; ++i) {
    world.scenes.push_back(world.scenes[0]);
    world.scenes.back().window_id = 100 + i;
    world.rasters.push_back(world.rasters[0]);
  }
  const Roi all{0, 0, 200, 150};
  const CompositeTile clean = Compose(world, all, Options());
  for (int y = 40; y < 60; ++y) {
    for (int x = 40; x < 60; ++x) world.rasters[1].intensity.at(x, y) += 120.0f;
  }
  const CompositeTile moved = Compose(world, all, Options());
  for (int y = 0; y < 150; ++y) {
    for (int x = 0; x < 200; ++x) {
      if (clean.count.at(x, y) != 3.0f) continue;
      ASSERT_NEAR(clean.median.at(x, y), moved.median.at(x, y), 1e-3);
    }
  }
}

TEST(TileCompositor, ReportsASingularPlacementByName) {
  World world = MakeWorld(2, 7, false);
  world.scenes[1].world_from_scene.matrix.setZero();
  const auto tile = ComposeTile(world.grid, {0, 0, 64, 64}, world.scenes, world.Reader(), Options(), kGoOn);
  ASSERT_FALSE(tile.ok());
  EXPECT_EQ(tile.status().code(), StatusCode::kCorrupt);
  EXPECT_NE(tile.status().message().find("scene 1 of window 10"), std::string::npos) << tile.status().message();
}

TEST(TileCompositor, StopsWhenAskedTo) {
  const World world = MakeWorld(6, 8, false);
  const auto tile = ComposeTile(world.grid, {0, 0, 200, 150}, world.scenes, world.Reader(), Options(), [](double) { return false; });
  EXPECT_EQ(tile.status().code(), StatusCode::kCancelled);
}

}  // namespace
}  // namespace trem
