// Question: how far is the automatic weight of the structure prior from the best one for the scene at hand, and how far is the engine's
// recursion from the converged batch solution? Baselines: the oracle, which is the best of a sweep of factors on the automatic weight
// against the known truth; with --batch also the best of a sweep of batch maximum a posteriori scenes with the true views.
// Truth: the scene filtered by [1 2 1]/4 in each axis on the 3:1 grid, scored on the cells that the last frames' snapshot calls seen.
//
// usage: regularisation_sweep [TRUTH_IMAGE --place X,Y ...] [options]; see --help
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/batch_map.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/truth_picture.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Settings {
  SequenceOptions sequence;
  EngineOptions engine;
  std::string truth;
  std::vector<std::string> places;
  std::vector<double> noises{2.0};
  std::vector<int> frames{1, 8, 30, 60};
  std::vector<double> factors{0.1, 0.18, 0.32, 0.56, 1.0, 1.8, 3.2, 5.6, 10.0};
  bool batch = false;
  bool filtered = false;
};

struct Place {
  std::string name;
  Image<float> truth;
};

void Declare(CLI::App* app, Settings* s) {
  s->sequence.roi_px = 101;
  s->sequence.speed_px = 0.2;
  s->sequence.psf_sigma_px = 0.6;
  app->add_option("truth", s->truth, "Picture to fly over, beside procedural ground");
  app->add_option("--place", s->places, "X,Y: upper left pixel of a part of TRUTH; may be repeated");
  app->add_option("--noise", s->noises, "Grey levels; several");
  app->add_option("--frames", s->frames, "Numbers of frames; several, rising");
  app->add_option("--factor", s->factors, "Factors on the automatic weight; several, rising, 1 among them");
  app->add_option("--roi", s->sequence.roi_px, "Side of the ROI, sensor pixels");
  app->add_option("--speed", s->sequence.speed_px, "Motion a frame, sensor pixels");
  app->add_option("--psf", s->sequence.psf_sigma_px, "Gaussian part of the PSF, sensor pixels; the engine is told");
  app->add_option("--seed", s->sequence.seed, "Of noise and procedural ground");
  static const std::map<std::string, UpdateMethod> kUpdates = {
      {"information", UpdateMethod::kInformation}, {"landweber", UpdateMethod::kLandweber}, {"pointwise", UpdateMethod::kPointwise}};
  static const std::map<std::string, StructurePriorKind> kStructures = {{"hubertv", StructurePriorKind::kHuberTv},
                                                                        {"membrane", StructurePriorKind::kMembrane},
                                                                        {"laplacian", StructurePriorKind::kLaplacian},
                                                                        {"bilateraltv", StructurePriorKind::kBilateralTv}};
  app->add_option("--update", s->engine.update, "information, landweber or pointwise")->transform(CLI::CheckedTransformer(kUpdates));
  app->add_option("--structure", s->engine.structure, "hubertv, membrane, laplacian or bilateraltv")
      ->transform(CLI::CheckedTransformer(kStructures));
  app->add_option("--window", s->engine.landweber_window, "landweber: frames of its window");
  app->add_flag("--revisit", s->engine.landweber_revisit, "landweber: earlier views are improved");
  app->add_option("--forgetting", s->engine.forgetting, "Per frame; 0: automatic");
  app->add_option("--iterations", s->engine.iterations, "Per frame; 0: automatic");
  app->add_flag("--filtered", s->filtered, "Score the scene filtered like the truth, whose band that is");
  app->add_flag("--batch", s->batch, "Also the batch solution with true views (slow)");
}

// Nothing when a place cannot be read.
std::optional<std::vector<Place>> LoadPlaces(const Settings& s) {
  const int width = testing::TruthWidth(s.sequence);
  const int height = testing::TruthHeight(s.sequence);
  std::vector<Place> places{{"procedural", testing::ProceduralTruth(width, height, s.sequence.seed)}};
  for (const std::string& name : s.places) {
    int x = 0;
    int y = 0;
    if (std::sscanf(name.c_str(), "%d,%d", &x, &y) != 2) {
      std::fprintf(stderr, "--place %s: expected X,Y\n", name.c_str());
      return std::nullopt;
    }
    Image<float> truth = testing::ReadTruthPicture(s.truth, x, y, width, height);
    if (truth.empty()) return std::nullopt;
    places.push_back({name, std::move(truth)});
  }
  return places;
}

// The last snapshot that the engine makes of the first `count` frames.
SceneSnapshot LastSnapshot(const RenderedSequence& sequence, int count, const EngineOptions& options) {
  SceneSnapshot last;
  const SnapshotSink sink = [&last](int, const SceneSnapshot& snapshot) {
    last = snapshot;
    return Status{};
  };
  const std::span<const FrameInput> frames(sequence.frames.data(), static_cast<std::size_t>(count));
  const Result<EngineResult> result = RunMapping(sequence.roi, frames, options, sink, {});
  TREM_CHECK_MSG(result.ok(), result.status().message());
  TREM_CHECK_MSG(result->segments.size() == 1, "the sequence broke into several scenes; choose a lower --speed");
  return last;
}

// Of the snapshot's scene, or of what [1 2 1]/4 leaves of it where all neighbours were seen.
double ScoreOf(const RenderedSequence& sequence, const Image<float>& filtered_truth, SceneSnapshot snapshot, bool filtered) {
  if (filtered) {
    const Image<float> information = snapshot.information;
    snapshot.intensity = testing::Filtered121(snapshot.intensity);
    for (int y = 0; y < information.height(); ++y) {
      for (int x = 0; x < information.width(); ++x) {
        float least = x > 0 && y > 0 && x + 1 < information.width() && y + 1 < information.height() ? information.at(x, y) : 0.0F;
        for (int k = 0; k < 9 && least > 0.0F; ++k) least = std::min(least, information.at(x + k % 3 - 1, y + k / 3 - 1));
        snapshot.information.at(x, y) = least;
      }
    }
  }
  return testing::ScoreSnapshot(sequence, filtered_truth, snapshot, 0, 0.4, 1e9).scene_db.value_or(0.0);
}

// The best batch scene over a sweep of absolute weights, on the cells of `like`.
std::pair<double, double> BestBatch(const RenderedSequence& sequence, const Image<float>& filtered, const Settings& s,
                                    int count, SceneSnapshot like) {
  const EngineOptions& options = s.engine;
  std::vector<testing::BatchFrame> frames;
  for (std::size_t t = 0; t < static_cast<std::size_t>(count); ++t) {
    View view;
    view.scene_from_sensor = sequence.TruthFromScene(0).Inverse() * sequence.truth_from_sensor[t];
    view.gain = sequence.gains[t];
    view.offset = sequence.offsets[t];
    frames.push_back({{&sequence.frames[t].pixels, sequence.roi, options.noise_sigma}, view});
  }
  testing::BatchMapOptions batch;
  batch.prior.kind = options.structure;
  Image<float> scene = like.intensity;
  double mean = 0.0;
  for (const float value : scene.pixels()) mean += value;
  double seen = 0.0;
  for (const float count_of_cell : like.information.pixels()) seen += count_of_cell > 0.0F ? 1.0 : 0.0;
  for (float& value : scene.pixels()) value = value != 0.0F ? value : static_cast<float>(mean / seen);
  double best_db = 0.0;
  double best_weight = 0.0;
  double previous_db = 0.0;
  for (double weight = 0.0008 * std::pow(options.noise_sigma, 2); weight < 20.0; weight *= 1.8) {
    batch.weight = weight;
    scene = testing::BatchMap(*MakePsf(options.psf, options.ratio), like.extent, frames, batch, std::move(scene));
    like.intensity = scene;
    const double db = ScoreOf(sequence, filtered, like, s.filtered);
    if (db > best_db) {
      best_db = db;
      best_weight = weight;
    }
    if (db < previous_db - 0.02) break;
    previous_db = db;
  }
  return {best_db, best_weight};
}

void SweepOne(const Settings& s, const std::string& name, const RenderedSequence& sequence, const Image<float>& filtered, int count) {
  double automatic = 0.0;
  double oracle = 0.0;
  double best_factor = 0.0;
  SceneSnapshot snapshot;
  std::string row;
  for (const double factor : s.factors) {
    EngineOptions options = s.engine;
    options.structure_weight *= factor;
    SceneSnapshot made = LastSnapshot(sequence, count, options);
    const double db = ScoreOf(sequence, filtered, made, s.filtered);
    if (factor == 1.0) {
      automatic = db;
      snapshot = std::move(made);
    }
    if (db > oracle) {
      oracle = db;
      best_factor = factor;
    }
    char text[16];
    std::snprintf(text, sizeof text, " %6.2f", db);
    row += text;
  }
  const double bicubic = testing::ScoreSnapshot(sequence, filtered, snapshot, 0, 0.4, 1e9).bicubic_db.value_or(0.0);
  std::printf("%-11s %5.1f %4d %8.2f %9.2f %7.2f %6.2f %6.2f |%s", name.c_str(), s.sequence.noise_sigma, count, bicubic, automatic, oracle,
              best_factor, oracle - automatic, row.c_str());
  if (s.batch) {
    const auto [db, weight] = BestBatch(sequence, filtered, s, count, std::move(snapshot));
    std::printf(" | %6.2f %6.2f %.4f", db, db - automatic, weight);
  }
  std::printf("\n");
  std::fflush(stdout);
}

int Run(Settings s) {
  s.engine.psf = {s.sequence.psf_sigma_px, s.sequence.fill_factor};
  s.sequence.frame_count = *std::max_element(s.frames.begin(), s.frames.end());
  if (std::find(s.factors.begin(), s.factors.end(), 1.0) == s.factors.end()) s.factors.push_back(1.0);
  const std::optional<std::vector<Place>> places = LoadPlaces(s);
  if (!places) return 3;
  std::printf("place       noise frms  bicubic automatic  oracle factor    gap |");
  for (const double factor : s.factors) std::printf(" %6.2f", factor);
  std::printf("%s\n", s.batch ? " |  batch    gap weight" : "");
  for (const Place& place : *places) {
    for (const double noise : s.noises) {
      s.sequence.noise_sigma = s.engine.noise_sigma = noise;
      const RenderedSequence sequence = testing::RenderSequence(place.truth, s.sequence);
      const Image<float> filtered = testing::Filtered121(sequence.truth);
      for (const int count : s.frames) SweepOne(s, place.name, sequence, filtered, count);
    }
  }
  return 0;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Settings settings;
  CLI::App app("The automatic weight of the structure prior against the best one");
  trem::Declare(&app, &settings);
  CLI11_PARSE(app, argc, argv);
  return trem::Run(settings);
}
