// Goal: what the spec says of the sensor reaches the manifest and from there the pixels: kernel, masks, saturation, estimated width; what
// cannot be right is refused with the file's name; the content of the files changes the manifest and with it every later task's key.
// Method: small simulated sorties in a temporary folder.
#include "worker/tasks/describe_sortie.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "proto/codec/convert.h"
#include "proto/codec/sortie_spec.h"
#include "tests/support/leaf_truth.h"
#include "tests/support/paths.h"
#include "tests/support/rendered_sequence.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/tasks/engine_options_of.h"
#include "worker/tasks/pixel_use.h"
#include "worker/tasks/sensor_of.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 120;
constexpr int kHeight = 100;

void WritePng(const std::filesystem::path& path, const Image<float>& frame) {
  cv::Mat pixels(frame.height(), frame.width(), CV_8U);
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < frame.width(); ++x) pixels.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(frame.at(x, y));
  }
  ASSERT_TRUE(cv::imwrite(path.string(), pixels));
}

// Twelve frames of a camera that moves by (1.3, 0.7) px a frame.
void WriteFrames(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  for (int i = 0; i < 12; ++i)
    WritePng(folder / ("f" + std::to_string(100 + i) + ".png"), testing::TexturedFrame(kWidth, kHeight, 1.3 * i, 0.7 * i, 1));
}

v1::Sortie SortieAt(const std::filesystem::path& folder) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path(folder.string());
  EXPECT_TRUE(CompleteSortie(&sortie).ok());
  return sortie;
}

std::string NoteText(const v1::SortieManifest& manifest, const std::string& code) {
  for (const v1::Note& note : manifest.notes()) {
    if (note.code() == code) return note.message();
  }
  return "";
}

// How far the middle of the image moved; the frame is linked.
Eigen::Vector2d CentreMotion(const v1::ManifestFrame& frame) {
  const Eigen::Vector2d centre(0.5 * kWidth, 0.5 * kHeight);
  return *AffineFromProto(frame.previous_from_current(), "motion") * centre - centre;
}

TEST(DescribeSortie, TheKernelFilesContentIsInTheManifest) {
  const testing::TempDir folder;
  WriteFrames(folder / "frames");
  testing::WriteFileContents(folder / "k.txt", "samples_per_pixel 3\n0 1 0 0\n1 4 1 0\n0 1 0 0\n");
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((folder / "frames").string());
  sortie.mutable_sensor()->set_psf_kernel_path((folder / "k.txt").string());
  ASSERT_TRUE(CompleteSortie(&sortie).ok());
  const auto manifest = DescribeSortie(sortie, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  const PsfParameters psf = PsfParametersOf(sortie.sensor(), manifest->sensor());
  EXPECT_EQ(psf.model, PsfModel::kKernelFile);
  EXPECT_EQ(psf.kernel.width, 4);
  EXPECT_EQ(psf.kernel.at(1, 1), 4.0F);
  EXPECT_TRUE(MakePsf(psf, 3).ok());
  EXPECT_THAT(NoteText(*manifest, "psf_kernel"), HasSubstr("centroid lies -0.167, +0.000 px"));
  EXPECT_EQ(manifest->sensor().psf_sigma_px(), 0.0) << "nothing to estimate";

  testing::WriteFileContents(folder / "k.txt", "samples_per_pixel 3\n0 1 0 0\n1 5 1 0\n0 1 0 0\n");
  const auto changed = DescribeSortie(sortie, {});
  ASSERT_TRUE(changed.ok());
  EXPECT_NE(SerializeDeterministic(*manifest), SerializeDeterministic(*changed)) << "another kernel is another job";

  testing::WriteFileContents(folder / "k.txt", "samples_per_pixel 3\n0 x\n");
  EXPECT_THAT(DescribeSortie(sortie, {}).status().message(), HasSubstr("k.txt:2:3: 'x'"));
}

TEST(DescribeSortie, AKernelRasterNeedsItsSampling) {
  const testing::TempDir folder;
  WritePng(folder / "k.png", Image<float>(5, 5, 9.0F));
  EXPECT_THAT(ReadPsfKernel((folder / "k.png").string()).status().message(), HasSubstr("k.png: the metadata item samples_per_pixel is ''"));
  WritePng(folder / "big.png", Image<float>(300, 5, 9.0F));
  EXPECT_THAT(ReadPsfKernel((folder / "big.png").string()).status().message(), HasSubstr("300 x 5 samples; expected at most 256 x 256"));
}

TEST(DescribeSortie, MaskedPixelsAreNeverUsed) {
  const testing::TempDir folder;
  WriteFrames(folder / "frames");
  Image<float> mask(kWidth, kHeight, 255.0F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < 20; ++x) mask.at(x, y) = 0.0F;
  }
  WritePng(folder / "mask.png", mask);
  Image<float> bad(kWidth, kHeight, 0.0F);
  bad.at(60, 50) = 1.0F;
  WritePng(folder / "bad.png", bad);
  v1::Sortie sortie = SortieAt(folder / "frames");
  sortie.mutable_sensor()->set_mask_path((folder / "mask.png").string());
  sortie.mutable_sensor()->set_bad_pixel_path((folder / "bad.png").string());
  const auto manifest = DescribeSortie(sortie, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->valid_roi().x0(), 20) << "windows are planned beside the mask";
  EXPECT_THAT(NoteText(*manifest, "pixels_masked"), HasSubstr("2001 pixels"));
  const auto use = PixelUse::Of(sortie.sensor(), *manifest);
  ASSERT_TRUE(use.ok());
  FrameInput frame;
  use->Take(Image<float>(kWidth, kHeight, 70.0F), {10, 40, 70, 60}, &frame);
  EXPECT_TRUE(std::isnan(frame.pixels.at(9, 0)));
  EXPECT_EQ(frame.pixels.at(10, 0), 70.0F);
  EXPECT_TRUE(std::isnan(frame.pixels.at(50, 10)));
  EXPECT_TRUE(frame.weights.empty());
  EXPECT_NEAR(use->UsablePart({10, 40, 70, 60}), 1.0 - 201.0 / 1200.0, 1e-12);
  // What burns in behind the mask does not pull on the motion of whole images.
  for (const v1::ManifestFrame& entry : manifest->frames()) {
    if (entry.previous_from_current_size() == 0) continue;
    EXPECT_NEAR(CentreMotion(entry).x(), 1.3, 0.3);
  }
}

TEST(DescribeSortie, AMaskOfAnotherSizeIsRefused) {
  const testing::TempDir folder;
  WriteFrames(folder / "frames");
  WritePng(folder / "mask.png", Image<float>(kWidth, kHeight - 1, 255.0F));
  v1::Sortie sortie = SortieAt(folder / "frames");
  sortie.mutable_sensor()->set_mask_path((folder / "mask.png").string());
  EXPECT_THAT(DescribeSortie(sortie, {}).status().message(), HasSubstr("mask.png is 120 x 99 pixels; expected 120 x 100 like the frames"));
}

// The overlay stands still while the ground moves: without the mask it holds the whole-image registration back or breaks it.
TEST(DescribeSortie, AMaskedOverlayDoesNotHoldTheMotionBack) {
  const testing::TempDir folder;
  std::filesystem::create_directories(folder / "frames");
  Image<float> mask(kWidth, kHeight, 255.0F);
  for (int y = 25; y < 75; ++y) {
    for (int x = 30; x < 90; ++x) mask.at(x, y) = 0.0F;
  }
  for (int i = 0; i < 8; ++i) {
    Image<float> frame = testing::TexturedFrame(kWidth, kHeight, 3.0 * i, 2.0 * i, 1);
    for (int y = 25; y < 75; ++y) {
      for (int x = 30; x < 90; ++x) frame.at(x, y) = (x / 5 + y / 5) % 2 == 0 ? 0.0F : 255.0F;
    }
    WritePng(folder / "frames" / ("f" + std::to_string(i) + ".png"), frame);
  }
  WritePng(folder / "mask.png", mask);
  const auto worst_error = [](const v1::SortieManifest& manifest) {
    double worst = 0.0;
    for (int i = 1; i < manifest.frames_size(); ++i) {
      const v1::ManifestFrame& frame = manifest.frames(i);
      const bool linked = frame.previous_from_current_size() == 6;
      worst = std::max(worst, linked ? (CentreMotion(frame) - Eigen::Vector2d(3.0, 2.0)).norm() : 99.0);
    }
    return worst;
  };
  v1::Sortie sortie = SortieAt(folder / "frames");
  sortie.mutable_sensor()->set_saturation_level(1000.0);
  const auto bare = DescribeSortie(sortie, {});
  ASSERT_TRUE(bare.ok()) << bare.status().message();
  sortie.mutable_sensor()->set_mask_path((folder / "mask.png").string());
  const auto masked = DescribeSortie(sortie, {});
  ASSERT_TRUE(masked.ok()) << masked.status().message();
  // A quarter of the image is overlay, in its middle, where the error is taken: what is left is extrapolated from around it.
  EXPECT_LT(worst_error(*masked), 1.5);
  EXPECT_GT(worst_error(*bare), 2.5) << "held at no motion, or not linked at all; masked: " << worst_error(*masked);
}

TEST(PixelUse, SaturatedPixelsHardlyCountAndPhotonNoiseWeighs) {
  v1::SortieManifest manifest;
  manifest.set_width_px(20);
  manifest.set_height_px(20);
  manifest.set_grey_offset(100.0);
  manifest.set_grey_scale(10.0);
  manifest.set_noise_sigma(2.0);
  manifest.mutable_sensor()->set_saturation_level(1000.0);
  manifest.mutable_sensor()->set_grey_median(400.0);
  Image<float> whole(20, 20, 400.0F);
  whole.at(5, 5) = 1000.0F;
  FrameInput frame;
  PixelUse::Of(v1::Sensor(), manifest)->Take(whole, {0, 0, 20, 20}, &frame);
  EXPECT_EQ(frame.pixels.at(0, 0), 30.0F);
  EXPECT_EQ(frame.pixels.at(5, 5), 90.0F) << "it keeps its value";
  EXPECT_EQ(frame.weights.at(5, 5), 0.05F);
  EXPECT_EQ(frame.weights.at(6, 5), 1.0F);

  v1::Sensor photons;
  photons.set_noise_sigma(10.0);
  photons.set_shot_noise(2.0);
  const NoiseModel model = NoiseModelOf(photons, manifest);
  EXPECT_NEAR(model.read_variance, 1.0, 1e-12);
  EXPECT_NEAR(model.typical_variance, (100.0 + 2.0 * 400.0) / 100.0, 1e-12);
  EXPECT_NEAR(model.Variance(40.0), model.typical_variance, 1e-12) << "40 internal grey levels above black are 400 of the source";
  PixelUse::Of(photons, manifest)->Take(Image<float>(20, 20, 100.0F), {0, 0, 20, 20}, &frame);
  EXPECT_NEAR(frame.weights.at(9, 9), 9.0 / 3.0, 1e-5);
}

TEST(PixelUse, VignettingIsUndoneAboveBlackAndItsNoiseCountsLess) {
  v1::SortieManifest manifest;
  manifest.set_width_px(21);
  manifest.set_height_px(21);
  manifest.set_grey_offset(100.0);
  manifest.set_grey_scale(10.0);
  manifest.mutable_sensor()->set_saturation_level(1000.0);
  manifest.mutable_sensor()->mutable_vignetting()->set_second(std::log(0.5));
  Image<float> whole(21, 21, 700.0F);
  whole.at(20, 20) = 1000.0F;
  FrameInput frame;
  PixelUse::Of(v1::Sensor(), manifest)->Take(whole, {0, 0, 21, 21}, &frame);
  EXPECT_NEAR(frame.pixels.at(10, 10), 60.0, 1e-4);
  EXPECT_NEAR(frame.weights.at(10, 10), 1.0, 1e-5);
  EXPECT_NEAR(frame.pixels.at(0, 0), (2.0 * 700.0 - 100.0) / 10.0, 1e-3) << "the source's grey levels are doubled, not the internal ones";
  EXPECT_NEAR(frame.weights.at(0, 0), 0.25, 1e-5);
  EXPECT_NEAR(frame.weights.at(20, 20), 0.05 * 0.25, 1e-5) << "what the sensor clipped was clipped before the vignetting was undone";
  EXPECT_NEAR(frame.weights.at(0, 20), 0.25, 1e-5) << "1400 is no saturated level: the sensor said 700";
}

TEST(DescribeSortie, TheWidthOfThePsfIsEstimatedWithItsError) {
  const testing::TempDir folder;
  std::filesystem::create_directories(folder / "frames");
  testing::SequenceOptions options;
  options.frame_count = 16;
  options.roi_px = 121;
  options.psf_sigma_px = 0.7;
  options.speed_px = 1.2;
  const testing::RenderedSequence sequence =
      testing::RenderSequence(testing::LeafTruth(testing::TruthWidth(options), testing::TruthHeight(options), 2), options);
  for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
    WritePng(folder / "frames" / ("f" + std::to_string(100 + i) + ".png"), sequence.frames[i].pixels);
  }
  v1::Sortie sortie = SortieAt(folder / "frames");
  const auto manifest = DescribeSortie(sortie, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  // Near the truth of 0.70, drawn a little towards what sensors usually are.
  EXPECT_NEAR(manifest->sensor().psf_sigma_px(), 0.69, 0.07) << NoteText(*manifest, "psf_estimate");
  EXPECT_NEAR(manifest->sensor().psf_sigma_error_px(), 0.068, 0.008);
  EXPECT_NEAR(manifest->noise_sigma(), 2.0, 0.2);
  EXPECT_NEAR(manifest->sensor().ceiling_cycles_per_px(), 1.0 / 0.9, 1e-12);
  v1::TaskSpec spec;
  *spec.mutable_sortie() = sortie;
  EXPECT_EQ(EngineOptionsOf(spec, *manifest).psf.sigma_px, manifest->sensor().psf_sigma_px());
  const auto again = DescribeSortie(sortie, {});
  EXPECT_EQ(SerializeDeterministic(*manifest), SerializeDeterministic(*again));

  sortie.mutable_source()->set_max_frames(6);
  const auto few = DescribeSortie(sortie, {});
  ASSERT_TRUE(few.ok());
  EXPECT_EQ(few->sensor().psf_sigma_px(), 0.55);
  EXPECT_EQ(few->sensor().psf_sigma_error_px(), 0.0);
  EXPECT_THAT(NoteText(*few, "psf_estimate"), HasSubstr("is assumed: it could not be estimated (there are too few frames"));
}

}  // namespace
}  // namespace trem
