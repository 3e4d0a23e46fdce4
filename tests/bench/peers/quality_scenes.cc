#include "tests/bench/peers/quality_scenes.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "worker/simulate/truth.h"

namespace trem::bench {
namespace {

constexpr int kBoards = 4;

// Upper left corners of the parts of the photograph that are used.
struct Crop {
  const char* name;
  int x;
  int y;
};
constexpr Crop kCrops[] = {{"trees", 150, 500}, {"trees, shadow and road", 1250, 400}, {"cars and gravel", 2212, 900}};

testing::SequenceOptions SequenceOf(const SceneSettings& s, int seed) {
  testing::SequenceOptions options;
  options.motion = testing::CameraMotion::kDwell;
  options.frame_count = s.frames;
  options.roi_px = s.roi_px;
  options.speed_px = 0.04;
  options.noise_sigma = s.noise_sigma;
  options.psf_sigma_px = s.psf_sigma_px;
  options.fill_factor = 0.9;
  options.seed = static_cast<std::uint64_t>(seed);
  return options;
}

Result<BenchScene> Natural(const SceneSettings& s, const Image<float>& photograph, const Crop& crop, int seed) {
  const testing::SequenceOptions options = SequenceOf(s, seed);
  const int width = testing::TruthWidth(options);
  const int height = testing::TruthHeight(options);
  if (crop.x + width > photograph.width() || crop.y + height > photograph.height()) {
    return InvalidInput(fmt::format("{}: {} x {} pixels; the crop \"{}\" needs {} x {} from ({}, {})", s.truth, photograph.width(),
                                    photograph.height(), crop.name, width, height, crop.x, crop.y));
  }
  Image<float> truth(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(photograph.row(crop.y + y) + crop.x, width, truth.row(y));
  return MakeBenchScene(crop.name, true, std::move(truth), options);
}

}  // namespace

void SceneSettings::Declare(CLI::App* app) {
  app->add_option("--truth", truth, "Photograph whose crops are flown over, too (brighton_park.jpg of the shared sample data)");
  app->add_option("--noise", noise_sigma, "Grey levels of 255")->check(CLI::Range(0.1, 50.0));
  app->add_option("--psf", psf_sigma_px, "Gaussian part of the PSF, sensor pixels")->check(CLI::Range(0.3, 2.0));
  app->add_option("--roi", roi_px, "Side of the ROI, sensor pixels")->check(CLI::Range(41, 400));
}

Status ForEachScene(const SceneSettings& s, int seed, const std::function<Status(const BenchScene&)>& use) {
  const testing::SequenceOptions options = SequenceOf(s, seed);
  TREM_RETURN_IF_ERROR(
      use(MakeBenchScene("procedural", false,
                         ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), options.seed, kBoards), options)));
  if (s.truth.empty()) return {};
  TREM_ASSIGN_OR_RETURN(const Image<float> photograph, ReadGrey(s.truth));
  for (const Crop& crop : kCrops) {
    TREM_ASSIGN_OR_RETURN(const BenchScene scene, Natural(s, photograph, crop, seed));
    TREM_RETURN_IF_ERROR(use(scene));
  }
  return {};
}

}  // namespace trem::bench
