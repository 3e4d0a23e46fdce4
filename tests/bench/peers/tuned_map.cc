#include "tests/bench/peers/tuned_map.h"

#include <cmath>

#include "tests/support/batch_map.h"

namespace trem::bench {
namespace {

constexpr int kMarginCells = 24;  // Of scene around the answers' grid, which later frames see.
constexpr double kFactor = 1.5;   // Between weights tried.
constexpr double kFirstWeight = 0.0125;

class Tuner {
 public:
  Tuner(const BenchScene& scene, int frame_count) : scene_(scene) {
    const int side = scene.AnswerSide();
    extent_ = {-kMarginCells, -kMarginCells, side + kMarginCells, side + kMarginCells};
    for (int t = 0; t < frame_count; ++t) {
      const auto index = static_cast<std::size_t>(t);
      const View view{scene.SceneFromSensor(t), scene.sequence.gains[index], scene.sequence.offsets[index]};
      frames_.push_back({{&scene.sequence.frames[index].pixels, scene.sequence.roi, scene.options.noise_sigma}, view});
    }
    const Image<float> bicubic = Bicubic(scene);
    last_ = Image<float>(extent_.width(), extent_.height());
    for (int y = 0; y < last_.height(); ++y) {
      for (int x = 0; x < last_.width(); ++x) last_.at(x, y) = SampleClamped(bicubic, x - kMarginCells, y - kMarginCells);
    }
  }

  // The weight that scores best, to within a factor of kFactor, uphill from the first one.
  TunedAnswer Tune() {
    TunedAnswer best = Solve(kFirstWeight);
    for (const double step : {kFactor, 1.0 / kFactor}) {
      bool better = false;
      for (double weight = best.setting * step; weight > 1e-5 && weight < 1e3; weight *= step) {
        TunedAnswer next = Solve(weight);
        if (next.db <= best.db) break;
        best = std::move(next);
        better = true;
      }
      if (better) break;
    }
    return best;
  }

 private:
  TunedAnswer Solve(double weight) {
    testing::BatchMapOptions options;
    options.weight = weight;
    options.tolerance = 0.02;  // Grey levels; a tenth of that moves no score by 0.005 dB.
    last_ = testing::BatchMap(*MakePsf(scene_.psf(), BenchScene::kRatio), extent_, frames_, options, std::move(last_));
    TunedAnswer answer;
    answer.setting = weight;
    for (const Image<float>& solved : {last_, testing::Filtered121(last_)}) {
      Image<float> cut(scene_.AnswerSide(), scene_.AnswerSide());
      for (int y = 0; y < cut.height(); ++y) std::copy_n(solved.row(y + kMarginCells) + kMarginCells, cut.width(), cut.row(y));
      const double db = Score(scene_, cut);
      if (db > answer.db) {
        answer.db = db;
        answer.answer = std::move(cut);
      }
    }
    return answer;
  }

  const BenchScene& scene_;
  Roi extent_;
  std::vector<testing::BatchFrame> frames_;
  Image<float> last_;  // Every solution is the next one's start.
};

}  // namespace

TunedAnswer TunedMap(const BenchScene& scene, int frame_count) { return Tuner(scene, frame_count).Tune(); }

}  // namespace trem::bench
