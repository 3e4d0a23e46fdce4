#include "worker/tre/uncertainty.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/parallel.h"
#include "mosaic/base/rng.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/emitted_band.h"

namespace trem {
namespace {

// Half side of the window of cells over which a variance is averaged.
constexpr int kAverageReach = 2;

float HuberSlopeWeight(float difference, const StructurePrior& prior) {
  if (prior.kind == StructurePriorKind::kMembrane) return 1.0F;
  const float size = std::abs(difference);
  return size <= prior.delta ? 1.0F : prior.delta / size;
}

struct LinearPrior {
  Image<float> across;  // lambda V of the difference to the right neighbour, ...
  Image<float> down;    // ... and to the one below; 0 at the border.
};

// The quadratic whose minimiser is one draw.
struct Perturbed {
  const LinearPrior* prior = nullptr;
  Image<float> data;        // Right-hand side of the data term: N(0, sigma^2 W).
  Image<float> prior_side;  // D' of the prior's right-hand side.
};

LinearPrior Linearised(const SceneBuffer& buffer, const StructurePrior& prior, float lambda) {
  const Image<float>& s = buffer.scene;
  LinearPrior p;
  p.across = Image<float>(s.width(), s.height());
  p.down = p.across;
  for (int y = 0; y < s.height(); ++y) {
    for (int x = 0; x < s.width(); ++x) {
      if (x + 1 < s.width()) p.across.at(x, y) = lambda * HuberSlopeWeight(s.at(x + 1, y) - s.at(x, y), prior);
      if (y + 1 < s.height()) p.down.at(x, y) = lambda * HuberSlopeWeight(s.at(x, y + 1) - s.at(x, y), prior);
    }
  }
  return p;
}

void DrawRightHandSide(const SceneBuffer& buffer, double noise_sigma, std::uint64_t seed, int probe, Perturbed* p) {
  const int width = buffer.scene.width();
  const int height = buffer.scene.height();
  p->data = Image<float>(width, height);
  p->prior_side = p->data;
  for (int y = 0; y < height; ++y) {
    const auto place = [](int v) { return static_cast<std::uint64_t>(static_cast<std::int64_t>(v)); };
    Rng rng({seed, static_cast<std::uint64_t>(probe), place(buffer.extent.x0), place(buffer.extent.y0 + y)});
    const auto draw = [&](float variance) {
      return static_cast<float>(noise_sigma * std::sqrt(static_cast<double>(variance)) * rng.Normal());
    };
    for (int x = 0; x < width; ++x) {
      p->data.at(x, y) = draw(std::max(buffer.weight.at(x, y), 0.0F));
      const float across = draw(p->prior->across.at(x, y));
      const float down = draw(p->prior->down.at(x, y));
      p->prior_side.at(x, y) -= across + down;
      if (x + 1 < width) p->prior_side.at(x + 1, y) += across;
      if (y + 1 < height) p->prior_side.at(x, y + 1) += down;
    }
  }
}

// out += lambda D' V D x - prior_side.
void AddPriorGradient(const Perturbed& p, const Image<float>& x, Image<float>* out) {
  for (int j = 0; j < x.height(); ++j) {
    for (int i = 0; i < x.width(); ++i) {
      if (i + 1 < x.width()) {
        const float flow = p.prior->across.at(i, j) * (x.at(i + 1, j) - x.at(i, j));
        out->at(i, j) -= flow;
        out->at(i + 1, j) += flow;
      }
      if (j + 1 < x.height()) {
        const float flow = p.prior->down.at(i, j) * (x.at(i, j + 1) - x.at(i, j));
        out->at(i, j) -= flow;
        out->at(i, j + 1) += flow;
      }
    }
  }
  for (std::size_t k = 0; k < out->pixels().size(); ++k) out->pixels()[k] -= p.prior_side.pixels()[k];
}

// The minimiser, from zero.
Image<float> Solve(const SceneBuffer& buffer, const Perturbed& p, float curvature, int iterations, Blur* blur) {
  Image<float> now(buffer.scene.width(), buffer.scene.height());
  Image<float> before = now;
  Image<float> start = now;
  Image<float> blurred = now;
  Image<float> gradient = now;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const float momentum = static_cast<float>(iteration) / static_cast<float>(iteration + 3);
    for (std::size_t k = 0; k < now.pixels().size(); ++k) {
      start.pixels()[k] = now.pixels()[k] + momentum * (now.pixels()[k] - before.pixels()[k]);
    }
    blur->Apply(start, &blurred);
    for (std::size_t k = 0; k < now.pixels().size(); ++k) {
      blurred.pixels()[k] = buffer.weight.pixels()[k] * blurred.pixels()[k] - p.data.pixels()[k];
    }
    blur->ApplyAdjoint(blurred, &gradient);
    AddPriorGradient(p, start, &gradient);
    std::swap(before, now);
    for (std::size_t k = 0; k < now.pixels().size(); ++k) {
      now.pixels()[k] = start.pixels()[k] - gradient.pixels()[k] / (buffer.majoriser.pixels()[k] + curvature + 1e-6F);
    }
  }
  return now;
}

// Mean over (2 reach + 1)^2 cells, fewer at the border.
Image<float> BoxMean(const Image<float>& image, int reach) {
  const auto pass = [reach](const Image<float>& in, bool along_rows) {
    Image<float> out(in.width(), in.height());
    const int size = along_rows ? in.width() : in.height();
    for (int y = 0; y < in.height(); ++y) {
      for (int x = 0; x < in.width(); ++x) {
        const int at = along_rows ? x : y;
        const int first = std::max(at - reach, 0);
        const int last = std::min(at + reach, size - 1);
        float sum = 0.0F;
        for (int k = first; k <= last; ++k) sum += along_rows ? in.at(k, y) : in.at(x, k);
        out.at(x, y) = sum / static_cast<float>(last - first + 1);
      }
    }
    return out;
  };
  return pass(pass(image, true), false);
}

// From the draws' variance to the error's. In the emitted band the draws nearly are the error; what is left is that edges are smoothed, in
// proportion to the slope. The two constants make one and two standard deviations cover 68 and 95 % on simulated sequences of a procedural
// and a natural scene, 10, 30 and 60 frames; tests/unit/worker/tre/uncertainty_test.cc measures the coverage on others.
float CalibratedVariance(float draws, float slope2) {
  constexpr float kDraws = 0.78F;
  constexpr float kSlope = 0.071F;
  return kDraws * draws + kSlope * slope2;
}

// Squared slope of the scene [(grey levels a cell)^2].
Image<float> SlopeSquared(const Image<float>& s) {
  Image<float> slope(s.width(), s.height());
  for (int y = 0; y < s.height(); ++y) {
    for (int x = 0; x < s.width(); ++x) {
      const float across = 0.5F * (s.at(std::min(x + 1, s.width() - 1), y) - s.at(std::max(x - 1, 0), y));
      const float down = 0.5F * (s.at(x, std::min(y + 1, s.height() - 1)) - s.at(x, std::max(y - 1, 0)));
      slope.at(x, y) = across * across + down * down;
    }
  }
  return slope;
}

}  // namespace

Image<float> SceneSigma(const SceneBuffer& buffer, const Image<float>& residual, const Psf& psf, const StructurePrior& prior, float lambda,
                        double noise_sigma, const UncertaintyOptions& options) {
  const LinearPrior linear = Linearised(buffer, prior, lambda);
  Image<float> variance(buffer.scene.width(), buffer.scene.height());
  const int together = std::max(options.threads, 1);
  std::vector<Blur> blurs(static_cast<std::size_t>(together), Blur(psf));
  std::vector<Image<float>> draws(static_cast<std::size_t>(together));
  for (int first = 0; first < options.probes; first += together) {
    const int count = std::min(together, options.probes - first);
    ForEachIndex(options.threads, count, [&](int index, int slot) {
      Perturbed p{&linear, {}, {}};
      DrawRightHandSide(buffer, noise_sigma, options.seed, first + index, &p);
      Blur* const blur = &blurs[static_cast<std::size_t>(slot)];
      draws[static_cast<std::size_t>(index)] = InEmittedBand(Solve(buffer, p, lambda * prior.curvature_max(), options.iterations, blur));
    });
    for (int index = 0; index < count; ++index) {
      const std::span<const float> draw = draws[static_cast<std::size_t>(index)].pixels();
      for (std::size_t k = 0; k < draw.size(); ++k) variance.pixels()[k] += draw[k] * draw[k] / static_cast<float>(options.probes);
    }
  }
  variance = BoxMean(variance, kAverageReach);
  const Image<float> slope2 = BoxMean(SlopeSquared(buffer.scene), 1);
  const float noise = static_cast<float>(noise_sigma);
  Image<float> sigma(variance.width(), variance.height());
  for (std::size_t k = 0; k < sigma.pixels().size(); ++k) {
    if (!(buffer.seen.pixels()[k] > 0.0F)) continue;
    const float misfit = std::max(residual.pixels()[k] / noise, 1.0F);
    sigma.pixels()[k] = std::sqrt(CalibratedVariance(misfit * misfit * variance.pixels()[k], slope2.pixels()[k]));
  }
  return sigma;
}

void ResidualMap::MoveTo(const Roi& extent) {
  if (extent == extent_) return;
  const Roi kept = Intersect(extent_, extent);
  for (Image<float>* plane : {&weight_, &squares_}) {
    Image<float> moved(extent.width(), extent.height());
    for (int y = kept.y0; y < kept.y1; ++y) {
      const float* from = plane->row(y - extent_.y0) + (kept.x0 - extent_.x0);
      std::copy(from, from + std::max(kept.width(), 0), moved.row(y - extent.y0) + (kept.x0 - extent.x0));
    }
    *plane = std::move(moved);
  }
  extent_ = extent;
}

void ResidualMap::Add(const Observation& observation, const View& view, double huber_sigmas, const SceneBuffer& buffer) {
  TREM_CHECK(buffer.extent == extent_);
  const Roi& roi = observation.roi;
  const float gain = static_cast<float>(view.gain);
  const float offset = static_cast<float>(view.offset);
  const float limit = static_cast<float>(huber_sigmas * observation.noise_sigma);
  for (int v = 0; v < roi.height(); ++v) {
    const float* pixels = observation.roi_pixels->row(v);
    for (int u = 0; u < roi.width(); ++u) {
      const float trust = observation.weight(u, v);
      if (std::isnan(pixels[u]) || !(trust > 0.0F)) continue;
      const Eigen::Vector2d scene = view.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double x = scene.x() - extent_.x0;
      const double y = scene.y() - extent_.y0;
      if (!CubicSupported(buffer.prediction, x, y)) continue;
      const float residual = std::abs(pixels[u] - offset - gain * SampleCubic(buffer.prediction, x, y));
      const int cx = static_cast<int>(x + 0.5);
      const int cy = static_cast<int>(y + 0.5);
      weight_.at(cx, cy) += trust;
      squares_.at(cx, cy) += trust * residual * std::min(residual, limit);
    }
  }
}

Image<float> ResidualMap::Rms(int ratio) const {
  const Image<float> weight = BoxMean(BoxMean(weight_, ratio / 2), ratio / 2);
  Image<float> rms = BoxMean(BoxMean(squares_, ratio / 2), ratio / 2);
  for (std::size_t k = 0; k < rms.pixels().size(); ++k) {
    const float w = weight.pixels()[k];
    rms.pixels()[k] = w > 0.0F ? std::sqrt(rms.pixels()[k] / w) : 0.0F;
  }
  return rms;
}

}  // namespace trem
