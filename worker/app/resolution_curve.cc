#include "worker/app/resolution_curve.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/tre/ring_correlation.h"

namespace trem {
namespace {

constexpr int kHalfMin = 2;
// Part of the ROI that both halves have to show.
constexpr double kCommonMin = 0.4;

// One half's scene, and where a pixel of its last frame falls in it.
struct Half {
  SceneRaster scene;
  int frame_index = 0;
  PlanarMap pixel_from_sensor;
};

const v1::ChainView* ViewOf(const PublishedScene& published, int frame_index) {
  for (const v1::ChainView& view : published.segment->chain()) {
    if (static_cast<int>(view.frame_index()) == frame_index) return &view;
  }
  return nullptr;
}

class Halves {
 public:
  Halves(const EnhancedWindow& enhanced, const PublishedScene& published, const EnhanceFrames& enhance)
      : enhanced_(enhanced), published_(published), enhance_(enhance), roi_(FromProto(enhanced.window->roi_in_sensor())) {}

  // Nothing when the frames do not make one scene.
  Result<std::optional<Half>> Make(int begin, int end) const {
    Roi roi = roi_;
    std::optional<int> target;
    if (published_.reference->has_roi_in_sensor()) {
      const v1::ChainView* first = ViewOf(published_, begin);
      if (first == nullptr) return std::optional<Half>();
      roi = FromProto(first->roi_in_sensor());
      target = begin;
    }
    TREM_ASSIGN_OR_RETURN(const v1::WindowResult window, enhance_(begin, end, roi, target));
    if (window.segments_size() != 1 || window.segments(0).scenes_size() == 0 || window.segments(0).chain_size() == 0) {
      return std::optional<Half>();
    }
    const v1::Segment& segment = window.segments(0);
    const v1::EmittedScene& scene = segment.scenes(segment.scenes_size() - 1);
    const v1::ChainView& last = segment.chain(segment.chain_size() - 1);
    Half half;
    half.frame_index = static_cast<int>(last.frame_index());
    TREM_ASSIGN_OR_RETURN(half.pixel_from_sensor, PixelFromSensor(last, scene));
    TREM_ASSIGN_OR_RETURN(const std::filesystem::path stored, enhanced_.store->Locate(FromProto(scene.raster())));
    TREM_ASSIGN_OR_RETURN(half.scene, ReadSceneRaster(stored, kScenePixelsMax));
    return std::optional<Half>(std::move(half));
  }

  // What the two halves agree to [cycles a sensor pixel]; nothing when they show too little in common.
  Result<std::optional<double>> Agreement(const Half& a, const Half& b) const {
    const v1::ChainView* view_a = ViewOf(published_, a.frame_index);
    const v1::ChainView* view_b = ViewOf(published_, b.frame_index);
    if (view_a == nullptr || view_b == nullptr) return std::optional<double>();
    TREM_ASSIGN_OR_RETURN(const PlanarMap published_from_a, PixelFromSensor(*view_a, *published_.scene));
    TREM_ASSIGN_OR_RETURN(const PlanarMap published_from_b, PixelFromSensor(*view_b, *published_.scene));
    const PlanarMap b_from_a = b.pixel_from_sensor * published_from_b.Inverse() * published_from_a * a.pixel_from_sensor.Inverse();
    const int width = a.scene.intensity.width();
    const int height = a.scene.intensity.height();
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    Image<float> of_a(width, height, kNan);
    Image<float> of_b(width, height, kNan);
    long long common = 0;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        if (!(a.scene.information.at(x, y) > 0.0F)) continue;
        of_a.at(x, y) = a.scene.intensity.at(x, y);
        of_b.at(x, y) = SampleSeen(b.scene, b_from_a * Eigen::Vector2d(x, y));
        common += std::isnan(of_b.at(x, y)) ? 0 : 1;
      }
    }
    const double cells = static_cast<double>(roi_.area()) * enhanced_.ratio * enhanced_.ratio;
    if (static_cast<double>(common) < kCommonMin * cells) return std::optional<double>();
    const double limit = AgreementLimit(of_a, of_b);
    if (limit <= 0.0) return std::optional<double>();
    return std::optional<double>(limit * enhanced_.ratio);
  }

 private:
  const EnhancedWindow& enhanced_;
  const PublishedScene& published_;
  const EnhanceFrames& enhance_;
  Roi roi_;
};

}  // namespace

Result<std::vector<ResolutionPoint>> ResolutionByFrames(const EnhancedWindow& enhanced, const PublishedScene& published, int frames_max,
                                                        const EnhanceFrames& enhance) {
  std::vector<ResolutionPoint> points;
  const auto& chain = published.segment->chain();
  const Halves halves(enhanced, published, enhance);
  const int available = std::min(chain.size(), frames_max);
  for (int half = kHalfMin; 2 * half <= available; half *= 2) {
    // What is left beyond the last doubling is worth a point of its own when it is much.
    const int count = 3 * half > available ? available / 2 : half;
    const auto frame_at = [&](int from_end) { return static_cast<int>(chain.Get(chain.size() - from_end).frame_index()); };
    const int middle = frame_at(count);
    TREM_ASSIGN_OR_RETURN(const std::optional<Half> earlier, halves.Make(frame_at(2 * count), middle));
    if (!earlier) break;
    TREM_ASSIGN_OR_RETURN(const std::optional<Half> later, halves.Make(middle, frame_at(1) + 1));
    if (!later) break;
    TREM_ASSIGN_OR_RETURN(const std::optional<double> limit, halves.Agreement(*earlier, *later));
    if (!limit) break;
    points.push_back({2 * count, *limit});
  }
  return points;
}

}  // namespace trem
