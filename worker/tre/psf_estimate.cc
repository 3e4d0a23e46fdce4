#include "worker/tre/psf_estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

namespace trem {
namespace {

// Candidate widths [px], about a factor of 1.3 apart. The middle three are always tried.
constexpr std::array<double, 6> kWidths_px = {0.28, 0.40, 0.55, 0.72, 0.95, 1.25};
constexpr std::size_t kFirst = 1;
constexpr std::size_t kLast = 3;
// Part of a trial's frames that are left for the scene to settle.
constexpr double kSettlingPart = 1.0 / 3.0;
constexpr int kScoredFramesMin = 6;
// Scores (log rms) of the candidates nearest the best one must differ by this much, or the likelihood is flat.
constexpr double kCurvatureMin = 0.002;
// Error of the estimate that the jackknife does not see: all trials share the model's simplifications.
constexpr double kErrorFloor_px = 0.04;
constexpr double kErrorMax_px = 0.12;
// The same for all trials, whatever their motion.
constexpr double kTrialForgetting = 0.985;

// log rms of the residuals, by trial and half of its scored frames.
struct Scores {
  std::vector<double> groups;
  double noise_sigma = 0.0;
  bool complete = true;
};

class Search {
 public:
  Search(std::span<const PsfTrial> trials, const EngineOptions& options, const std::function<bool(double)>& progress)
      : trials_(trials), options_(options), progress_(progress) {
    options_.structure_weight *= kTrialStructureWeight;
    options_.learn_weight = false;
    if (options_.forgetting == 0.0) options_.forgetting = kTrialForgetting;
    options_.registration = RegistrationMethod::kGaussNewton;
  }

  Result<PsfEstimate> Run() {
    PsfEstimate estimate;
    // The noise that is left once the texture is explained is a better guess than what single frames show.
    options_.noise_known = true;
    TREM_RETURN_IF_ERROR(Try(kWidths_px[2]));
    const Scores& first = scores_.at(kWidths_px[2]);
    if (!first.complete) {
      estimate.doubt = "the trial frames could not be registered";
      return estimate;
    }
    if (first.noise_sigma < 0.9 * options_.noise_sigma) {
      options_.noise_sigma = first.noise_sigma;
      scores_.clear();
    }
    TREM_ASSIGN_OR_RETURN(const std::optional<std::size_t> best, FindBest());
    if (!best.has_value()) {
      estimate.doubt = "the trial frames could not be registered";
      return estimate;
    }
    estimate.noise_sigma = scores_.at(kWidths_px[*best]).noise_sigma;
    if (*best == 0 || *best + 1 == kWidths_px.size()) {
      estimate.doubt = *best == 0 ? "the frames are sharper than any width that is tried" : "the likelihood does not fall for wide point spread functions";
      return estimate;
    }
    Judge(*best, &estimate);
    return estimate;
  }

 private:
  // Runs the trials with one width, unless that was done.
  Status Try(double width_px) {
    if (scores_.contains(width_px)) return {};
    if (progress_ && !progress_(static_cast<double>(tried_++) / (kWidths_px.size() + 1))) return Cancelled("asked to stop");
    EngineOptions options = options_;
    options.psf.sigma_px = width_px;
    Scores scores;
    std::vector<double> spreads;
    for (const PsfTrial& trial : trials_) {
      const auto keep_nothing = [](int, const SceneSnapshot&) { return Status(); };
      TREM_ASSIGN_OR_RETURN(const EngineResult result, RunMapping(trial.roi, trial.frames, options, keep_nothing, {}));
      Score(trial, result, &scores, &spreads);
    }
    if (!spreads.empty()) {
      std::nth_element(spreads.begin(), spreads.begin() + static_cast<std::ptrdiff_t>(spreads.size() / 2), spreads.end());
      scores.noise_sigma = spreads[spreads.size() / 2];
    }
    scores_[width_px] = scores;
    return {};
  }

  static void Score(const PsfTrial& trial, const EngineResult& result, Scores* scores, std::vector<double>* spreads) {
    const std::size_t settled = static_cast<std::size_t>(std::ceil(kSettlingPart * static_cast<double>(trial.frames.size())));
    std::vector<double> logs;
    // One segment only: another one begins with a new scene that has not settled.
    if (result.segments.size() == 1) {
      const std::vector<ChainEntry>& chain = result.segments.front().chain;
      for (std::size_t k = settled; k < chain.size(); ++k) {
        const Registration& registration = chain[k].registration;
        if (!(registration.residual_rms > 0.0)) continue;
        logs.push_back(std::log(registration.residual_rms));
        spreads->push_back(registration.residual_sigma);
      }
    }
    if (logs.size() < kScoredFramesMin) {
      scores->complete = false;
      return;
    }
    const std::size_t half = logs.size() / 2;
    const auto mean = [&logs](std::size_t begin, std::size_t end) {
      double sum = 0.0;
      for (std::size_t k = begin; k < end; ++k) sum += logs[k];
      return sum / static_cast<double>(end - begin);
    };
    scores->groups.push_back(mean(0, half));
    scores->groups.push_back(mean(half, logs.size()));
  }

  // Mean score of a width; `left_out`: a group that does not count.
  double Mean(double width_px, std::optional<std::size_t> left_out) const {
    const Scores& scores = scores_.at(width_px);
    double sum = 0.0;
    int count = 0;
    for (std::size_t g = 0; g < scores.groups.size(); ++g) {
      if (left_out == g) continue;
      sum += scores.groups[g];
      ++count;
    }
    return sum / count;
  }

  // Index of the best width, with both neighbours tried where there are any; nothing when a trial fails.
  Result<std::optional<std::size_t>> FindBest() {
    std::size_t low = kFirst;
    std::size_t high = kLast;
    while (true) {
      for (std::size_t i = low; i <= high; ++i) {
        TREM_RETURN_IF_ERROR(Try(kWidths_px[i]));
        if (!scores_.at(kWidths_px[i]).complete) return std::optional<std::size_t>();
      }
      std::size_t best = low;
      for (std::size_t i = low; i <= high; ++i) {
        if (Mean(kWidths_px[i], {}) < Mean(kWidths_px[best], {})) best = i;
      }
      if (best == low && low > 0) {
        --low;
      } else if (best == high && high + 1 < kWidths_px.size()) {
        ++high;
      } else {
        return std::optional<std::size_t>(best);
      }
    }
  }

  // Vertex of the parabola through the best width and its neighbours, and half the second difference per log width squared.
  struct Vertex {
    double sigma_px = 0.0;
    double curvature = 0.0;
  };
  Vertex VertexAt(std::size_t best, std::optional<std::size_t> left_out) const {
    std::array<double, 3> x{};
    std::array<double, 3> y{};
    for (std::size_t i = 0; i < 3; ++i) {
      x[i] = std::log(kWidths_px[best - 1 + i]);
      y[i] = Mean(kWidths_px[best - 1 + i], left_out);
    }
    const double below = (y[1] - y[0]) / (x[1] - x[0]);
    const double above = (y[2] - y[1]) / (x[2] - x[1]);
    const double curvature = (above - below) / (x[2] - x[0]);
    if (!(curvature > 0.0)) return {kWidths_px[best], 0.0};
    return {std::exp(std::clamp(0.5 * (x[0] + x[1]) - 0.5 * below / curvature, x[0], x[2])), curvature};
  }

  void Judge(std::size_t best, PsfEstimate* estimate) const {
    const Vertex vertex = VertexAt(best, {});
    const double rise = std::max(Mean(kWidths_px[best - 1], {}), Mean(kWidths_px[best + 1], {})) - Mean(kWidths_px[best], {});
    const std::size_t groups = scores_.at(kWidths_px[best]).groups.size();
    double sum = 0.0;
    for (std::size_t g = 0; g < groups; ++g) sum += std::pow(VertexAt(best, g).sigma_px - vertex.sigma_px, 2);
    const double n = static_cast<double>(groups);
    estimate->sigma_px = vertex.sigma_px;
    estimate->error_px = std::hypot(std::sqrt((n - 1.0) / n * sum), kErrorFloor_px);
    if (vertex.curvature == 0.0 || rise < kCurvatureMin) {
      estimate->doubt = "all widths predict the frames about as well";
    } else if (estimate->error_px > kErrorMax_px) {
      estimate->doubt = "the trials disagree";
    }
  }

  std::span<const PsfTrial> trials_;
  EngineOptions options_;
  const std::function<bool(double)>& progress_;
  std::map<double, Scores> scores_;
  int tried_ = 0;
};

}  // namespace

Result<PsfEstimate> EstimatePsfSigma(std::span<const PsfTrial> trials, const EngineOptions& options, const std::function<bool(double)>& progress) {
  if (trials.empty()) return PsfEstimate{0.0, 0.0, 0.0, "there are too few frames or too little texture"};
  return Search(trials, options, progress).Run();
}

}  // namespace trem
