// Goal: a target is followed through the field of view, piles up into a scene that is better than any of its frames, is lost honestly when
// it is hidden or leaves, is found again only when it is the same thing, and inputs that cannot be tracked are refused in words. Method: a
// textured vehicle on ground that moves otherwise, rendered four times finer than the sensor and integrated by Gaussian and detector.
#include "worker/tre/target_engine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

using Outcome = FrameReport::Outcome;
using ::testing::HasSubstr;

constexpr int kWidth = 200;
constexpr int kHeight = 130;
constexpr int kFine = 4;   // Samples a sensor pixel and axis.
constexpr int kCells = 3;  // Of truth, a sensor pixel.
constexpr int kTargetWidth = 38;
constexpr int kTargetHeight = 30;
constexpr double kNoise = 2.0;

// Markings of a few cells, denser than the ground's.
Image<float> Markings(int width_px, int height_px, std::uint64_t seed) {
  const Image<float> large = testing::ProceduralTruth(4 * kCells * width_px, 4 * kCells * height_px, seed);
  Image<float> markings(kCells * width_px, kCells * height_px);
  for (int y = 0; y < markings.height(); ++y) {
    for (int x = 0; x < markings.width(); ++x) markings.at(x, y) = large.at(4 * x + 1, 4 * y + 1);
  }
  return markings;
}

// A rectangle of picture at a place in the sensor.
struct Sprite {
  const Image<float>* picture = nullptr;                              // kCells a sensor pixel.
  Eigen::Vector2d centre;                                             // Sensor px.
  Eigen::Matrix2d picture_from_sensor = Eigen::Matrix2d::Identity();  // Turned by its angle.
};

struct World {
  int frame_count = 40;
  Eigen::Vector2d start{60.3, 50.2};    // Of the target's centre.
  Eigen::Vector2d velocity{1.7, 0.45};  // In the sensor, px a frame.
  double swing = 0.01;                  // Of its heading, rad.
  int hidden_begin = 0;                 // Frames in which foliage covers it.
  int hidden_end = 0;
  std::optional<Eigen::Vector2d> decoy;  // A look-alike so far from the target.
  bool decoy_is_a_copy = false;
  Image<float> ground = testing::ProceduralTruth(kCells * (kWidth + 180), kCells*(kHeight + 60), 11);
  Image<float> target = Markings(kTargetWidth, kTargetHeight, 12);
  Image<float> other = Markings(kTargetWidth, kTargetHeight, 13);
  Image<float> foliage = Markings(64, 56, 14);

  Eigen::Vector2d CentreAt(int t) const {
    return start + t * velocity + Eigen::Vector2d(0.3 * std::sin(1.9 * t), 0.25 * std::cos(2.6 * t));
  }
  double AngleAt(int t) const { return swing * std::sin(0.2 * t); }
  Roi RoiAt(int t) const {
    const Eigen::Vector2d c = CentreAt(t);
    const int x0 = static_cast<int>(std::lround(c.x() - 0.5 * (kTargetWidth + 3)));
    const int y0 = static_cast<int>(std::lround(c.y() - 0.5 * (kTargetHeight + 3)));
    return {x0, y0, x0 + kTargetWidth + 4, y0 + kTargetHeight + 4};
  }
  // Where the camera looks: ground point of sensor point 0, in sensor px.
  Eigen::Vector2d CameraAt(int t) const { return {25.0 + 1.9 * t + 1.5 * std::sin(1.3 * t), 30.0 + 2.0 * std::sin(0.9 * t)}; }

  Image<float> Render(int t) const {
    std::vector<Sprite> sprites;
    const Eigen::Matrix2d turned = Eigen::Rotation2Dd(-AngleAt(t)).toRotationMatrix();
    sprites.push_back({&target, CentreAt(t), turned});
    if (decoy) sprites.push_back({decoy_is_a_copy ? &target : &other, CentreAt(t) + *decoy, turned});
    if (t >= hidden_begin && t < hidden_end) sprites.push_back({&foliage, CentreAt(t)});
    const Eigen::Vector2d camera = CameraAt(t);
    cv::Mat1f fine(kHeight * kFine, kWidth * kFine);
    for (int y = 0; y < fine.rows; ++y) {
      for (int x = 0; x < fine.cols; ++x) {
        const Eigen::Vector2d u((x + 0.5) / kFine - 0.5, (y + 0.5) / kFine - 0.5);
        fine(y, x) = Radiance(u, camera, sprites);
      }
    }
    // Gaussian of 0.55 px and a detector of 0.9 px.
    cv::GaussianBlur(fine, fine, {}, 0.55 * kFine, 0.55 * kFine, cv::BORDER_REPLICATE);
    const cv::Mat1f box = (cv::Mat1f(1, 5) << 0.3F, 1.0F, 1.0F, 1.0F, 0.3F) / 3.6F;
    cv::sepFilter2D(fine, fine, -1, box, box, {-1, -1}, 0.0, cv::BORDER_REPLICATE);
    Rng rng({21, static_cast<std::uint64_t>(t)});
    Image<float> frame(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        // A pixel's centre lies between four fine samples.
        const cv::Rect middle(kFine * x + kFine / 2 - 1, kFine * y + kFine / 2 - 1, 2, 2);
        frame.at(x, y) = static_cast<float>(cv::mean(fine(middle))[0] + kNoise * rng.Normal());
      }
    }
    return frame;
  }

  float Radiance(const Eigen::Vector2d& u, const Eigen::Vector2d& camera, const std::vector<Sprite>& sprites) const {
    for (std::size_t k = sprites.size(); k > 0; --k) {
      const Sprite& sprite = sprites[k - 1];
      const Eigen::Vector2d d = sprite.picture_from_sensor * (u - sprite.centre);
      const double x = kCells * d.x() + 0.5 * (sprite.picture->width() - 1);
      const double y = kCells * d.y() + 0.5 * (sprite.picture->height() - 1);
      if (CubicSupported(*sprite.picture, x, y)) return SampleCubic(*sprite.picture, x, y);
    }
    const Eigen::Vector2d g = kCells * (u + camera);
    return SampleCubic(ground, g.x(), g.y());
  }
};

struct Tracked {
  Status status;
  EngineResult result;
  std::vector<SceneSnapshot> snapshots;

  const ChainEntry* EntryOf(int frame) const {
    for (const ChainEntry& entry : result.segments[0].chain) {
      if (entry.frame_index == frame) return &entry;
    }
    return nullptr;
  }
};

// `symbol`: pixels of the sensor that an overlay covers in every frame; they are masked.
Tracked Track(const World& world, const TargetRequest& request, EngineOptions options = {}, const Roi& symbol = {}) {
  Tracked tracked;
  const TargetFrames frames = [&](int t) -> Result<TargetFrame> {
    TargetFrame frame;
    frame.pixels = world.Render(t);
    for (int y = symbol.y0; y < symbol.y1; ++y) {
      for (int x = symbol.x0; x < symbol.x1; ++x) frame.pixels.at(x, y) = std::numeric_limits<float>::quiet_NaN();
    }
    if (t > 0) frame.previous_from_current = Affine{Eigen::Matrix2d::Identity(), world.CameraAt(t) - world.CameraAt(t - 1)};
    return frame;
  };
  const SnapshotSink sink = [&](int, const SceneSnapshot& snapshot) {
    tracked.snapshots.push_back(snapshot);
    return Status{};
  };
  options.noise_sigma = kNoise;
  Result<EngineResult> result = RunTarget(request, frames, options, sink, {});
  tracked.status = result.status();
  if (result.ok()) tracked.result = std::move(*result);
  return tracked;
}

TargetRequest RequestIn(const World& world, int reference) {
  return {world.RoiAt(reference), reference, 0, world.frame_count, {0, 0, kWidth, kHeight}};
}

// How far the target's centre [sensor px] is from where a chain entry says it is.
double CentreError(const World& world, const ChainEntry& entry, int reference) {
  const Roi roi = world.RoiAt(reference);
  const Eigen::Vector2d in_scene = 3.0 * (world.CentreAt(reference) - Eigen::Vector2d(roi.x0, roi.y0));
  return (entry.registration.view.scene_from_sensor.Inverse() * in_scene - world.CentreAt(entry.frame_index)).norm();
}

// PSNR of the scene and of the reference frame's bicubic enlargement inside an ellipse of the target.
std::pair<double, double> ScoreScene(const World& world, const Tracked& tracked, int reference) {
  const Image<float> filtered = testing::Filtered121(world.target);
  const SceneSnapshot& snapshot = tracked.snapshots.back();
  const Image<float> frame = world.Render(reference);
  const Roi roi = world.RoiAt(reference);
  std::vector<double> scene, bicubic, truth;
  for (int y = 0; y < filtered.height(); ++y) {
    for (int x = 0; x < filtered.width(); ++x) {
      const Eigen::Vector2d c(x - 0.5 * (filtered.width() - 1), y - 0.5 * (filtered.height() - 1));
      if (std::hypot(2.0 * c.x() / filtered.width(), 2.0 * c.y() / filtered.height()) > 0.85) continue;
      const Eigen::Vector2d u = world.CentreAt(reference) + Eigen::Rotation2Dd(world.AngleAt(reference)) * (c / kCells);
      const Eigen::Vector2d cell = 3.0 * (u - Eigen::Vector2d(roi.x0, roi.y0)) - Eigen::Vector2d(snapshot.extent.x0, snapshot.extent.y0);
      scene.push_back(SampleCubic(snapshot.intensity, cell.x(), cell.y()));
      bicubic.push_back(SampleCubic(frame, u.x(), u.y()));
      truth.push_back(filtered.at(x, y));
    }
  }
  return {testing::Psnr(scene, truth).value(), testing::Psnr(bicubic, truth).value()};
}

TEST(TargetEngine, FollowsATargetOverGroundThatMovesOtherwiseBothWaysFromTheReference) {
  const World world;
  for (const int reference : {0, 17, 39}) {
    const Tracked tracked = Track(world, RequestIn(world, reference));
    ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
    ASSERT_EQ(tracked.result.segments.size(), 1U);
    ASSERT_EQ(tracked.result.segments[0].chain.size(), 40U) << "every frame, reference " << reference;
    for (int t = 0; t < 40; ++t) {
      const ChainEntry& entry = tracked.result.segments[0].chain[static_cast<std::size_t>(t)];
      EXPECT_EQ(entry.frame_index, t);
      EXPECT_LT(CentreError(world, entry, reference), 0.12) << "frame " << t << ", reference " << reference;
      EXPECT_EQ(tracked.result.frames[static_cast<std::size_t>(t)].outcome, t == reference ? Outcome::kStartedScene : Outcome::kRegistered);
    }
    ASSERT_EQ(tracked.snapshots.size(), 1U);
    EXPECT_EQ(tracked.snapshots[0].frame_begin, 0);
    EXPECT_EQ(tracked.snapshots[0].frame_end, 40);
    const auto [scene_db, bicubic_db] = ScoreScene(world, tracked, reference);
    EXPECT_GT(scene_db, bicubic_db + 3.0) << "reference " << reference;
  }
}

TEST(TargetEngine, LosesATargetWhileItIsHiddenAndFindsItAgain) {
  World world;
  world.hidden_begin = 18;
  world.hidden_end = 28;
  const Tracked tracked = Track(world, RequestIn(world, 0));
  ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
  for (int t = 0; t < world.frame_count; ++t) {
    const FrameReport& report = tracked.result.frames[static_cast<std::size_t>(t)];
    const bool hidden = t >= world.hidden_begin && t < world.hidden_end;
    EXPECT_EQ(report.outcome == Outcome::kLost, hidden) << "frame " << t << ": " << report.reason;
    if (hidden) {
      EXPECT_FALSE(report.reason.empty());
      continue;
    }
    ASSERT_NE(tracked.EntryOf(t), nullptr) << "frame " << t;
    EXPECT_LT(CentreError(world, *tracked.EntryOf(t), 0), 0.12) << "frame " << t;
  }
  EXPECT_THAT(tracked.result.frames[28].reason, HasSubstr("found again after 10 lost frames"));
  const auto [scene_db, bicubic_db] = ScoreScene(world, tracked, 0);
  EXPECT_GT(scene_db, bicubic_db + 2.5) << "what hid the target must not be in its scene";
}

TEST(TargetEngine, TakesNoLookAlikeForTheTarget) {
  for (const bool copy : {false, true}) {
    World world;
    world.hidden_begin = 18;
    world.hidden_end = world.frame_count;  // The target never comes back; the other one stays in view.
    world.decoy_is_a_copy = copy;
    // A thing of the same size with other markings close by; an exact copy only where the target cannot be.
    world.decoy = copy ? Eigen::Vector2d(95.0, 55.0) : Eigen::Vector2d(-10.0, 46.0);
    world.velocity = {0.9, -0.3};
    const Tracked tracked = Track(world, RequestIn(world, 0));
    ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
    EXPECT_EQ(tracked.result.segments[0].chain.back().frame_index, 17) << "copy: " << copy;
    EXPECT_EQ(tracked.result.segments[0].chain.size(), 18U) << "copy: " << copy;
    for (int t = 18; t < (copy ? 30 : world.frame_count); ++t) {
      EXPECT_EQ(tracked.result.frames[static_cast<std::size_t>(t)].outcome, Outcome::kLost) << "frame " << t;
    }
  }
}

TEST(TargetEngine, SaysThatATargetHasLeftTheFieldOfViewAndByWhichEdge) {
  World world;
  world.start = {120.0, 60.0};
  world.velocity = {3.4, 0.1};
  const Tracked tracked = Track(world, RequestIn(world, 0));
  ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
  int last = 0;
  for (const ChainEntry& entry : tracked.result.segments[0].chain) {
    last = entry.frame_index;
    EXPECT_LT(CentreError(world, entry, 0), 0.2) << "frame " << entry.frame_index;
  }
  EXPECT_GE(last, 18) << "followed as long as it is wholly in view";
  EXPECT_LT(world.CentreAt(last).x(), kWidth + 8) << "never registered once it is out";
  EXPECT_EQ(tracked.result.frames.back().outcome, Outcome::kLost);
  EXPECT_THAT(tracked.result.frames.back().reason, HasSubstr("left the field of view over its right edge"));
}

TEST(TargetEngine, RefusesWhatCannotBeTracked) {
  World world;
  TargetRequest request = RequestIn(world, 3);
  request.roi_in_sensor = {170, 20, 210, 60};
  EXPECT_THAT(Track(world, request).status.message(), HasSubstr("is not inside the sensor"));
  request.roi_in_sensor = {20, 20, 35, 60};
  EXPECT_THAT(Track(world, request).status.message(), HasSubstr("too small to register"));
  request = RequestIn(world, 3);
  request.reference = 40;
  EXPECT_THAT(Track(world, request).status.message(), HasSubstr("reference frame 40 is not one of the frames 0:40"));

  // Flat, and flat along one direction only.
  for (const bool striped : {false, true}) {
    World plain;
    for (int y = 0; y < plain.target.height(); ++y) {
      for (int x = 0; x < plain.target.width(); ++x) {
        plain.target.at(x, y) = striped && (x / 9) % 2 == 0 ? 160.0F : 100.0F;
      }
    }
    request = RequestIn(plain, 3);
    const Roi roi = request.roi_in_sensor;
    request.roi_in_sensor = {roi.x0 + 6, roi.y0 + 6, roi.x1 - 6, roi.y1 - 6};
    plain.swing = 0.0;
    const Status status = Track(plain, request).status;
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput) << striped;
    EXPECT_THAT(status.message(), HasSubstr("no texture")) << striped;
  }

  const TargetFrames unusable = [](int) -> Result<TargetFrame> { return TargetFrame{"is blank", {}, {}, {}}; };
  const SnapshotSink sink = [](int, const SceneSnapshot&) { return Status{}; };
  EXPECT_THAT(RunTarget(RequestIn(world, 3), unusable, {}, sink, {}).status().message(),
              HasSubstr("frame 3 is blank; choose another frame"));
}

TEST(TargetEngine, ProjectiveViewsFollowATargetAsWell) {
  const World world;
  EngineOptions options;
  options.view_model = ViewModel::kProjective;
  const Tracked tracked = Track(world, RequestIn(world, 17), options);
  ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
  ASSERT_EQ(tracked.result.segments[0].chain.size(), 40U);
  for (const ChainEntry& entry : tracked.result.segments[0].chain) {
    EXPECT_LT(CentreError(world, entry, 17), 0.12) << "frame " << entry.frame_index;
    EXPECT_EQ(entry.registration.corner_covariance.rows(), 8) << "frame " << entry.frame_index;
  }
  const auto [scene_db, bicubic_db] = ScoreScene(world, tracked, 17);
  EXPECT_GT(scene_db, bicubic_db + 3.0);
}

TEST(TargetEngine, ATargetIsFollowedBehindAMaskedSymbol) {
  const World world;
  // A bar of a crosshair, across which the target moves: what it covers is NaN, and the scene is whole all the same.
  const Roi symbol{92, 20, 96, 110};
  const Tracked tracked = Track(world, RequestIn(world, 0), {}, symbol);
  ASSERT_TRUE(tracked.status.ok()) << tracked.status.message();
  int behind = 0;
  for (int t = 0; t < world.frame_count; ++t) {
    ASSERT_NE(tracked.EntryOf(t), nullptr) << "frame " << t << ": " << tracked.result.frames[static_cast<std::size_t>(t)].reason;
    EXPECT_LT(CentreError(world, *tracked.EntryOf(t), 0), 0.15) << "frame " << t;
    behind += Intersect(world.RoiAt(t), symbol).empty() ? 0 : 1;
  }
  EXPECT_GT(behind, 10) << "the symbol has to be in the way, or nothing is tested";
  const auto [scene_db, bicubic_db] = ScoreScene(world, tracked, 0);
  EXPECT_GT(scene_db, bicubic_db + 2.5);
}

TEST(TargetEngine, TwoRunsGiveTheSameBytes) {
  World world;
  world.frame_count = 12;
  world.hidden_begin = 6;
  world.hidden_end = 8;
  const Tracked a = Track(world, RequestIn(world, 4));
  const Tracked b = Track(world, RequestIn(world, 4));
  ASSERT_EQ(a.snapshots.size(), 1U);
  ASSERT_EQ(b.snapshots.size(), 1U);
  EXPECT_TRUE(std::ranges::equal(a.snapshots[0].intensity.pixels(), b.snapshots[0].intensity.pixels()));
  EXPECT_TRUE(std::ranges::equal(a.snapshots[0].information.pixels(), b.snapshots[0].information.pixels()));
}

}  // namespace
}  // namespace trem
