// Goal: an emitted scene survives the disk bit for bit, whole and in part, its bytes depend on its pixels only, and damaged or foreign
// files are refused with a message. Method: random images of sizes around the block size.
#include "mosaic/raster/scene_raster.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

#include "mosaic/base/file.h"
#include "mosaic/raster/geotiff.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

constexpr long long kMaxPixels = 1 << 22;

Image<float> Wave(int width, int height, float phase) {
  Image<float> image(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x)
      image.at(x, y) = 100.0f + 50.0f * std::sin(0.1f * static_cast<float>(x) + 0.07f * static_cast<float>(y) + phase);
  }
  return image;
}

bool SamePixels(const Image<float>& a, const Image<float>& b) {
  return a.width() == b.width() && a.height() == b.height() &&
         std::memcmp(a.pixels().data(), b.pixels().data(), a.pixels().size_bytes()) == 0;
}

TEST(SceneRaster, ComesBackBitForBitAtAnySize) {
  const testing::TempDir folder;
  for (const auto& [width, height] : {std::pair{1, 1}, {255, 257}, {256, 256}, {603, 300}}) {
    Image<float> intensity = Wave(width, height, 0.0f);
    intensity.at(0, 0) = std::numeric_limits<float>::quiet_NaN();
    const Image<float> information = Wave(width, height, 1.0f);
    const std::filesystem::path path = folder.path() / "scene.tif";
    const Status written = WriteSceneRaster(path, intensity, information);
    ASSERT_TRUE(written.ok()) << written.message();
    const auto scene = ReadSceneRaster(path, kMaxPixels);
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    EXPECT_TRUE(SamePixels(scene->intensity, intensity));
    EXPECT_TRUE(SamePixels(scene->information, information));
    EXPECT_EQ(scene->roi, (Roi{0, 0, width, height}));
  }
}

TEST(SceneRaster, CarriesStandardDeviationsAndResidualsWhenThereAreSome) {
  const testing::TempDir folder;
  const SceneRaster made{Wave(40, 30, 0.0f), Wave(40, 30, 1.0f), Wave(40, 30, 2.0f), Wave(40, 30, 3.0f), {}};
  ASSERT_TRUE(WriteSceneRaster(folder.path() / "scene.tif", made).ok());
  const auto scene = ReadSceneRaster(folder.path() / "scene.tif", kMaxPixels);
  ASSERT_TRUE(scene.ok()) << scene.status().message();
  EXPECT_TRUE(SamePixels(scene->intensity, made.intensity));
  EXPECT_TRUE(SamePixels(scene->information, made.information));
  EXPECT_TRUE(SamePixels(scene->sigma, made.sigma));
  EXPECT_TRUE(SamePixels(scene->residual, made.residual));
  ASSERT_TRUE(WriteSceneRaster(folder.path() / "plain.tif", made.intensity, made.information).ok());
  EXPECT_TRUE(ReadSceneRaster(folder.path() / "plain.tif", kMaxPixels)->sigma.empty());
}

TEST(SceneRaster, ReadsAPartThatCrossesBlocks) {
  const testing::TempDir folder;
  const Image<float> intensity = Wave(600, 520, 0.0f);
  const Image<float> information = Wave(600, 520, 2.0f);
  ASSERT_TRUE(WriteSceneRaster(folder.path() / "scene.tif", intensity, information).ok());
  const Roi roi{200, 250, 530, 515};
  const auto scene = ReadSceneRaster(folder.path() / "scene.tif", kMaxPixels, roi);
  ASSERT_TRUE(scene.ok()) << scene.status().message();
  ASSERT_EQ(scene->intensity.width(), roi.width());
  ASSERT_EQ(scene->intensity.height(), roi.height());
  for (int y = 0; y < roi.height(); ++y) {
    for (int x = 0; x < roi.width(); ++x) {
      ASSERT_EQ(scene->intensity.at(x, y), intensity.at(x + roi.x0, y + roi.y0));
      ASSERT_EQ(scene->information.at(x, y), information.at(x + roi.x0, y + roi.y0));
    }
  }
}

TEST(SceneRaster, WritesTheSameBytesEveryTime) {
  const testing::TempDir folder;
  const Image<float> intensity = Wave(300, 300, 0.0f);
  ASSERT_TRUE(WriteSceneRaster(folder.path() / "a.tif", intensity, intensity).ok());
  ASSERT_TRUE(WriteSceneRaster(folder.path() / "b.tif", intensity, intensity).ok());
  EXPECT_EQ(*ReadFile(folder.path() / "a.tif", 1 << 24), *ReadFile(folder.path() / "b.tif", 1 << 24));
}

TEST(SceneRaster, RefusesWhatIsNotASceneAndSaysWhy) {
  const testing::TempDir folder;
  const std::filesystem::path path = folder.path() / "scene.tif";
  const auto missing = ReadSceneRaster(path, kMaxPixels);
  ASSERT_FALSE(missing.ok());
  EXPECT_EQ(missing.status().code(), StatusCode::kNotFound);

  std::ofstream(path) << "this is a text";
  const auto text = ReadSceneRaster(path, kMaxPixels);
  ASSERT_FALSE(text.ok());
  EXPECT_EQ(text.status().code(), StatusCode::kCorrupt);
  EXPECT_NE(text.status().message().find("scene.tif"), std::string::npos) << text.status().message();

  FloatRaster one_band;
  one_band.bands.push_back({"only", Wave(10, 10, 0.0f)});
  ASSERT_TRUE(WriteFloatRaster(path, one_band).ok());
  const auto wrong = ReadSceneRaster(path, kMaxPixels);
  ASSERT_FALSE(wrong.ok());
  EXPECT_NE(wrong.status().message().find("1 bands; expected 2"), std::string::npos) << wrong.status().message();
}

TEST(SceneRaster, LimitsWhatItReads) {
  const testing::TempDir folder;
  const std::filesystem::path path = folder.path() / "scene.tif";
  ASSERT_TRUE(WriteSceneRaster(path, Wave(100, 100, 0.0f), Wave(100, 100, 0.0f)).ok());
  EXPECT_EQ(ReadSceneRaster(path, 9999).status().code(), StatusCode::kExhausted);
  EXPECT_TRUE(ReadSceneRaster(path, 9999, Roi{0, 0, 99, 100}).ok());
  EXPECT_EQ(ReadSceneRaster(path, kMaxPixels, Roi{1, 0, 101, 100}).status().code(), StatusCode::kCorrupt);
}

TEST(SceneRaster, ATruncatedFileIsAnErrorNotPixels) {
  const testing::TempDir folder;
  const std::filesystem::path path = folder.path() / "scene.tif";
  ASSERT_TRUE(WriteSceneRaster(path, Wave(600, 600, 0.0f), Wave(600, 600, 1.0f)).ok());
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  EXPECT_FALSE(ReadSceneRaster(path, kMaxPixels).ok());
}

TEST(SceneRaster, AFolderThatDoesNotExistIsAnErrorThatNamesThePath) {
  const testing::TempDir folder;
  const Status status = WriteSceneRaster(folder.path() / "no/such/scene.tif", Wave(4, 4, 0.0f), Wave(4, 4, 0.0f));
  ASSERT_FALSE(status.ok());
  EXPECT_NE(status.message().find("no/such/scene.tif"), std::string::npos) << status.message();
}

}  // namespace
}  // namespace trem
