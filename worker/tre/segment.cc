#include "worker/tre/segment.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "worker/sensor/bicubic.h"
#include "worker/tre/brightness.h"
#include "worker/tre/fill_unseen.h"
#include "worker/tre/frame_check.h"
#include "worker/tre/landweber_update.h"
#include "worker/tre/pointwise_update.h"

namespace trem {
namespace {

// Iterations: first frame, ordinary frame.
constexpr int kFirstIterations = 20;
constexpr int kFrameIterations = 4;
// The buffer may grow to this multiple of the ROI's footprint before a snapshot is taken: a piece of ground is then in about
// 1 + 1 / (kGrowth - 1) snapshots.
constexpr double kGrowth = 1.5;
// Frames after which a cell is settled enough to register to: this part of those that see it in all, within bounds. What fewer frames
// alias lets new ground drift.
constexpr float kSettledPart = 0.2F;
constexpr float kSettledFrames = 2.5F;
constexpr float kSettledFramesMax = 4.0F;
// Further iterations on ground that came into view with this frame.
constexpr int kNewGroundIterations = 10;
// Part of a gain's and offset's deviation from 1 and 0 that is expected to be there still in the next frame.
constexpr double kPhotometryMemory = 0.98;

// Automatic forgetting: the memory, in frames, over the frames for which the ROI covers a piece of ground; and its bounds.
constexpr double kMemoryPerDwell = 1.0;
constexpr double kForgettingMin = 0.95;
// A ROI that dwells forgets so little a frame that it is left to add up to this.
constexpr double kForgettingStep = 0.005;
constexpr double kProgressRate = 0.1;
// Cells are counted anew when this part of the frames have been added since, or so many.
constexpr int kCountsPart = 3;
constexpr int kCountEveryMax = 8;
// POINTWISE: steps of the other schemes that one of its sweeps is worth, about.
constexpr int kStepsPerSweep = 4;
// A scene that is iterated to convergence wants more weight than one a few steps from its start: log of the factor.
constexpr double kConvergedLogFactor = 0.5;
// LANDWEBER revisits its window every so many frames, and believes views up to this far from where they were [sensor px].
constexpr int kRevisitEvery = 4;
constexpr double kRevisitSigmaPx = 0.1;

InformationOptions UpdateOptions(const EngineOptions& options) {
  InformationOptions update;
  update.prior.kind = options.structure;
  update.threads = options.threads;
  return update;
}

std::unique_ptr<UpdateScheme> MakeScheme(const Psf& psf, const EngineOptions& options, std::uint64_t segment_id) {
  switch (options.update) {
    case UpdateMethod::kInformation:
      break;
    case UpdateMethod::kLandweber:
      return std::make_unique<LandweberUpdate>(psf, LandweberOptions{.window = options.landweber_window});
    case UpdateMethod::kPointwise:
      return std::make_unique<PointwiseUpdate>(psf, options.seed, segment_id);
  }
  return nullptr;
}

Affine NominalView(const Roi& roi, int ratio) {
  Affine scene_from_sensor;
  scene_from_sensor.linear *= ratio;
  scene_from_sensor.offset = -ratio * Eigen::Vector2d(roi.x0, roi.y0);
  return scene_from_sensor;
}

Observation ObservationOf(const FrameInput& frame, const Roi& roi, double noise_sigma) {
  return {&frame.pixels, roi, noise_sigma, frame.weights.empty() ? nullptr : &frame.weights};
}

// Rounds outwards to multiples of `step`, so that the buffer is reallocated now and then instead of at every frame.
Roi RoundedOut(const Roi& roi, int step) {
  const auto down = [step](int x) { return static_cast<int>(std::floor(static_cast<double>(x) / step)) * step; };
  return {down(roi.x0), down(roi.y0), down(roi.x1 + step - 1), down(roi.y1 + step - 1)};
}

// Cells of `a` that lie in `parts`.
long long CellsIn(const Roi& a, const std::vector<Roi>& parts) {
  long long cells = 0;
  for (const Roi& part : parts) cells += std::max(Intersect(a, part).area(), 0LL);
  return cells;
}

// Joins rectangles that are filtered faster as one: a row of a rectangle costs about as much as some cells beside it.
std::vector<Roi> Joined(std::vector<Roi> parts) {
  constexpr long long kRowCells = 32;
  const auto cost = [](const Roi& roi) { return roi.height() * (roi.width() + kRowCells); };
  for (std::size_t i = 0; i < parts.size(); ++i) {
    for (std::size_t k = i + 1; k < parts.size(); ++k) {
      const Roi both = Union(parts[i], parts[k]);
      if (cost(both) > cost(parts[i]) + cost(parts[k])) continue;
      parts[i] = both;
      parts.erase(parts.begin() + static_cast<std::ptrdiff_t>(k));
      k = i;  // What is larger now may take in others.
    }
  }
  return parts;
}

// What of `now` lies beyond one side of `before`.
struct Advance {
  int cells = 0;
  Roi strip;  // That side of `now`, wide enough to hold the PSF's support.
};

// Left, right, top, bottom.
std::array<Advance, 4> NewGround(const Roi& before, const Roi& now) {
  constexpr int kWidthMin = 24;
  const auto width = [&](int cells, int size) { return std::min(std::max(cells, kWidthMin), size); };
  std::array<Advance, 4> sides;
  sides[0].cells = std::max(before.x0 - now.x0, 0);
  sides[1].cells = std::max(now.x1 - before.x1, 0);
  sides[2].cells = std::max(before.y0 - now.y0, 0);
  sides[3].cells = std::max(now.y1 - before.y1, 0);
  for (Advance& side : sides) side.strip = now;
  sides[0].strip.x1 = now.x0 + width(sides[0].cells, now.width());
  sides[1].strip.x0 = now.x1 - width(sides[1].cells, now.width());
  sides[2].strip.y1 = now.y0 + width(sides[2].cells, now.height());
  sides[3].strip.y0 = now.y1 - width(sides[3].cells, now.height());
  return sides;
}

// Registers a frame whose brightness may have jumped from the prior's.
JudgedRegistration RegisterOverJump(const Observation& observation, const Reference& reference, const RegistrationRequest& request) {
  const std::optional<Brightness> jump = BrightnessJump(observation, reference, request.prior.mean);
  if (!jump) return Register(observation, reference, request);
  RegistrationRequest jumped = request;
  jumped.prior.mean.gain = jump->gain;
  jumped.prior.mean.offset = jump->offset;
  jumped.prior.gain_sigma *= jump->gain;
  for (View& candidate : jumped.candidates) {
    candidate.gain = jump->gain;
    candidate.offset = jump->offset;
  }
  JudgedRegistration judged = Register(observation, reference, jumped);
  // What looked like a jump may be other ground: then the old brightness holds.
  return judged.doubt.empty() ? judged : Register(observation, reference, request);
}

}  // namespace

Segment::Segment(const Roi& roi, const SeparablePsf& psf, const EngineOptions& options, std::uint64_t segment_id, Extent extent)
    : roi_(roi),
      options_(options),
      segment_id_(segment_id),
      extent_(extent),
      margin_(psf.radius() + 3),
      update_(Blur(psf), UpdateOptions(options)),
      regularisation_(psf, options.structure, options.ratio, options.learn_weight, options.threads),
      scheme_(MakeScheme(psf, options, segment_id)),
      emitted_log_factor_(kConvergedLogFactor),
      buffer_(RoundedOut(Footprint(NominalView(roi, options.ratio)), 16)),
      residuals_(buffer_.extent),
      place_(roi, options.ratio, options.view_model),
      movers_(options.ratio) {
  view_.scene_from_sensor = NominalView(roi, options.ratio);
  // A weight that is not learnt is for comparisons of predictions, which snapshots take no part in.
  if (scheme_ == nullptr && options.learn_weight) kept_.emplace(InformationOptions{}.huber_sigmas, options.threads);
  const int parameters = ParameterCount(options.view_model);
  covariance_ = velocity_covariance_ = CornerMatrix::Zero(parameters, parameters);
}

Roi Segment::Footprint(const PlanarMap& scene_from_sensor) const {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e30);
  Eigen::Vector2d high = -low;
  for (const int x : {roi_.x0, roi_.x1 - 1}) {
    for (const int y : {roi_.y0, roi_.y1 - 1}) {
      const Eigen::Vector2d cell = scene_from_sensor * Eigen::Vector2d(x, y);
      low = low.cwiseMin(cell);
      high = high.cwiseMax(cell);
    }
  }
  return {static_cast<int>(std::floor(low.x())) - margin_, static_cast<int>(std::floor(low.y())) - margin_,
          static_cast<int>(std::ceil(high.x())) + margin_ + 1, static_cast<int>(std::ceil(high.y())) + margin_ + 1};
}

void Segment::Iterate(const Roi& region, int iterations, StructureWeight weight) {
  const StructurePrior prior{options_.structure, weight.delta};
  const float lambda = static_cast<float>(options_.structure_weight) * weight.lambda;
  if (scheme_ != nullptr) {
    const bool by_user = options_.iterations > 0 && iterations == options_.iterations;
    if (options_.update == UpdateMethod::kPointwise && !by_user) iterations = (iterations + kStepsPerSweep - 1) / kStepsPerSweep;
    scheme_->Iterate(region, iterations, prior, lambda, &buffer_);
    update_.Predict(Grown(region, update_.psf().radius()), &buffer_);
    return;
  }
  update_.set_prior(prior);
  update_.Iterate(region, iterations, lambda, &buffer_);
}

double Segment::Forgetting() const {
  if (options_.forgetting > 0.0) return options_.forgetting;
  // A cell that will be seen by N frames more must not remember all of them alike: views accumulate error with the ROI's progress, and the
  // oldest samples hold the scene where the first views were. A ROI that stays has one origin and keeps everything.
  return std::max(1.0 - 1.0 / (kMemoryPerDwell * DwellFrames()), kForgettingMin);
}

void Segment::ReviseKeptFrames() {
  const Reference reference{&buffer_.prediction, &buffer_.seen, buffer_.extent.x0, buffer_.extent.y0, options_.ratio, kSettledFrames};
  const std::span<KeptFrame> frames = scheme_->kept_frames();
  for (std::size_t i = 0; i + 1 < frames.size(); ++i) {
    KeptFrame& frame = frames[i];
    if (frame.frame_index == first_frame_) continue;  // Its view is the gauge.
    ViewPrior prior;
    prior.mean = frame.view;
    prior.information = CornerMatrix::Identity(covariance_.rows(), covariance_.rows()) / (kRevisitSigmaPx * kRevisitSigmaPx);
    const Registration again = RegisterGaussNewton(frame.observation(), reference, prior, frame.view, {});
    if (!again.converged || again.overlap < kRegistrationOverlapMin || again.motion_from_prior_px > 3.0 * kRevisitSigmaPx) continue;
    frame.view = again.view;
    revised_.push_back({frame.frame_index, again});
  }
}

const Image<float>* Segment::MaskMovers(const FrameInput& frame, double noise_sigma) {
  const Image<float>* const own = frame.weights.empty() ? nullptr : &frame.weights;
  const bool mask_movers = options_.mover_mask == Correction::kOn;
  if (!mask_movers && options_.detector_bias == Correction::kOff) return own;
  residual_.Compute(ObservationOf(frame, roi_, noise_sigma), view_, buffer_, options_.threads);
  if (!mask_movers) return own;
  movers_.Judge(residual_, view_, roi_, noise_sigma, options_.threads);
  for (const MoverMask::Block& block : movers_.outvoted()) {
    const int ratio = options_.ratio;
    const Roi ground{block.x * ratio, block.y * ratio, (block.x + 1) * ratio, (block.y + 1) * ratio};
    if (kept_) kept_->Forget(ground);
    buffer_.Forget(buffer_.InBuffer(ground));
  }
  if (movers_.masked_count() == 0) return own;
  masked_ += movers_.masked_count();
  weights_ = own != nullptr ? *own : Image<float>(roi_.width(), roi_.height(), 1.0F);
  const bool anew = !movers_.outvoted().empty();
  for (int v = 0; v < roi_.height(); ++v) {
    const unsigned char* mask = movers_.mask().row(v);
    float* weights = weights_.row(v);
    float* residual = residual_.value.row(v);
    for (int u = 0; u < roi_.width(); ++u) {
      if (mask[u] == 0) continue;
      residual[u] = std::numeric_limits<float>::quiet_NaN();
      // Ground that is made anew is made from this frame.
      if (anew && movers_.IsOutvoted(view_.scene_from_sensor * Eigen::Vector2d(roi_.x0 + u, roi_.y0 + v))) continue;
      weights[u] = 0.0F;
    }
  }
  return &weights_;
}

std::vector<Roi> Segment::FillNew(const FrameInput& frame, const View& view, const Roi& region) {
  std::vector<Roi> filled = FillUnseen(frame, RoiOf(frame), view, region, &buffer_, &continued_);
  const Roi& e = buffer_.extent;
  for (Roi& part : filled) part = {part.x0 + e.x0, part.y0 + e.y0, part.x1 + e.x0, part.y1 + e.y0};
  std::vector<Roi> stale;
  for (const Roi& part : filled) stale.push_back(Grown(part, update_.psf().radius()));
  for (const Roi& part : Joined(std::move(stale))) update_.Predict(part, &buffer_);
  return filled;
}

void Segment::IterateNewGround(const Roi& region, const std::vector<Roi>& filled, StructureWeight weight) {
  const std::array<Advance, 4> sides = NewGround(last_region_, region);
  for (std::size_t k = 0; k < sides.size(); ++k) {
    const Roi& strip = sides[k].strip;
    const long long cells = CellsIn(strip, filled);
    if (sides[k].cells == 0 || cells == 0) continue;
    // A line that comes in gives two lines of cells a value: its own, and one that the frame has measured now instead of continued. A ROI
    // that sways back over what it has seen does not.
    fresh_lines_[k] += static_cast<double>(cells) / (2.0 * std::max(strip.width(), strip.height()));
    // Frames that are kept make the picture anew in the end: a line of cells, on which there may be no sample yet, is left to later ones.
    if (kept_ && fresh_lines_[k] < options_.ratio) continue;
    fresh_lines_[k] = 0.0;
    Iterate(strip, kNewGroundIterations, weight);
  }
}

void Segment::Update(const FrameInput& frame, const Observation& observation, const View& view, int iterations) {
  const Roi region = RegionOf(view);
  regularisation_.Learn(observation, view);
  const std::vector<Roi> filled = FillNew(frame, view, region);
  pending_forgetting_ *= Forgetting();
  const bool due = 1.0 - pending_forgetting_ >= kForgettingStep;
  update_.set_forgetting(due ? pending_forgetting_ : 1.0);
  if (due) pending_forgetting_ = 1.0;
  update_.AddFrame(observation, view, region, &buffer_);
  if (kept_) {
    KeptFrame kept{frame.frame_index, observation.roi, observation.noise_sigma, frame.pixels, {}, view};
    if (observation.weights != nullptr) kept.weights = *observation.weights;
    kept_->Add(std::move(kept), region, Forgetting(), buffer_);
  }
  if (scheme_ != nullptr) scheme_->AddFrame(frame.frame_index, observation, view);
  // A settled scene that is dwelt on changes little with a frame: then its counts and the weight are good for some.
  const int every = std::clamp(frame_count_ / kCountsPart, 1, kCountEveryMax);
  if (update_.RefreshSeen(region, options_.ratio, every, &buffer_)) {
    weight_ = regularisation_.Weight(region, buffer_, observation.noise_sigma);
  }
  if (frame_count_ > 0) IterateNewGround(region, filled, weight_);
  Iterate(region, iterations, weight_);
  // The first frame is fitted by a scene of its own.
  if (options_.uncertainty && frame_count_ > 0) {
    residuals_.Add(observation, view, InformationOptions{}.huber_sigmas, buffer_);
  }
  if (options_.landweber_revisit && scheme_ != nullptr && frame_count_ % kRevisitEvery == kRevisitEvery - 1) ReviseKeptFrames();
  regularisation_.MakeProbe(region, buffer_, observation.noise_sigma);
  last_region_ = region;
  ++frame_count_;
  // A target is followed forwards and then backwards.
  first_unemitted_ = std::min(first_unemitted_, frame.frame_index);
  last_added_ = std::max(last_added_, frame.frame_index);
}

Registration Segment::Begin(const FrameInput& frame, double noise_sigma) {
  first_unemitted_ = first_frame_ = frame.frame_index;
  last_added_ = frame.frame_index;
  Update(frame, ObservationOf(frame, RoiOf(frame), noise_sigma), view_, kFirstIterations);
  Registration registration;
  registration.view = view_;
  registration.corner_covariance = CornerMatrix::Identity(covariance_.rows(), covariance_.rows()) * 1e-8;
  registration.gain_offset_covariance = Eigen::Matrix2d::Identity() * 1e-8;
  registration.residual_rms = noise_sigma;
  registration.residual_sigma = noise_sigma;
  registration.correlation = 1.0;
  registration.overlap = 1.0;
  registration.converged = true;
  const Observation observation = ObservationOf(frame, RoiOf(frame), noise_sigma);
  place_.Add({}, place_.Measure(observation, ReferenceNow(SeenMin()), view_), observation, view_, 1.0);
  // A target's frames have ROIs of their own and all lie on its first one; a scheme that keeps frames revisits them itself.
  const bool revisits = scheme_ == nullptr || scheme_->remembers();
  if (extent_ == Extent::kMoves && revisits) early_.emplace_back(frame, registration);
  return registration;
}

JudgedRegistration Segment::RegisterFrame(const FrameInput& frame, double noise_sigma) {
  Expectation expectation;
  const bool dynamics = options_.dynamics_sigma_px > 0.0;
  expectation.prior = dynamics ? PredictByDynamics() : Predict(frame);
  // Gain and offset wander about 1 and 0: a first-order process, so that no drift of the scene's grey levels goes unopposed for ever.
  expectation.prior.mean.gain = 1.0 + kPhotometryMemory * (view_.gain - 1.0);
  expectation.prior.mean.offset = kPhotometryMemory * view_.offset;
  expectation.prior.gain_sigma = 0.1;
  expectation.prior.offset_sigma = 15.0;
  const bool measured = frame.previous_from_current.has_value();
  expectation.motion_px_max = MotionTolerancePx(frame, expectation.prior.mean.scene_from_sensor);
  if (dynamics && frame_count_ > 1) {
    expectation.motion_px_max = 3.0 + 5.0 * std::sqrt(expectation.prior.information.inverse().diagonal().maxCoeff());
  }
  if (dynamics && measured) expectation.candidates.push_back(Predict(frame).mean);
  View still = view_;
  expectation.candidates.push_back(still);
  still.scene_from_sensor = view_.scene_from_sensor * lost_from_current_ * previous_from_current_;
  expectation.candidates.push_back(still);
  return RegisterFrame(frame, noise_sigma, expectation);
}

JudgedRegistration Segment::RegisterFrame(const FrameInput& frame, double noise_sigma, const Expectation& expectation) {
  RegistrationRequest request;
  request.prior = expectation.prior;
  request.candidates = expectation.candidates;
  request.motion_px_max = expectation.motion_px_max;
  request.method = options_.registration;
  request.gain_offset = options_.gain_offset;
  request.threads = options_.threads;
  request.stream[0] = options_.seed;
  request.stream[1] = segment_id_;
  request.stream[2] = static_cast<std::uint64_t>(frame.frame_index);
  const Reference reference = ReferenceNow(SeenMin());
  Observation observation = ObservationOf(frame, RoiOf(frame), noise_sigma);
  Image<float> weights = frame.weights;
  if (movers_.Hide(request.prior.mean, RoiOf(frame), &weights)) observation.weights = &weights;
  JudgedRegistration judged = RegisterOverJump(observation, reference, request);
  placed_ = PlaceOf(frame, judged.registration, noise_sigma);
  judged.registration.corner_covariance += placed_->covariance;
  return judged;
}

Reference Segment::ReferenceNow(float seen_min) const {
  return {&buffer_.prediction, &buffer_.seen, buffer_.extent.x0, buffer_.extent.y0, options_.ratio, seen_min};
}

double Segment::DwellFrames() const { return std::min(roi_.width(), roi_.height()) / std::max(progress_px_.norm(), 1e-6); }

float Segment::SeenMin() const {
  const float settled = std::clamp(kSettledPart * static_cast<float>(DwellFrames()), kSettledFrames, kSettledFramesMax);
  return std::clamp(0.75F * static_cast<float>(frame_count_), 0.75F, settled);
}

Image<float> Segment::PredictFrame(const View& view, const Roi& roi) const {
  Image<float> picture(roi.width(), roi.height(), std::numeric_limits<float>::quiet_NaN());
  for (int v = 0; v < roi.height(); ++v) {
    for (int u = 0; u < roi.width(); ++u) {
      const Eigen::Vector2d scene = view.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double x = scene.x() - buffer_.extent.x0;
      const double y = scene.y() - buffer_.extent.y0;
      if (!CubicSupported(buffer_.prediction, x, y)) continue;
      if (!(buffer_.seen.at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5)) >= SeenMin())) continue;
      picture.at(u, v) = static_cast<float>(view.gain) * SampleCubic(buffer_.prediction, x, y) + static_cast<float>(view.offset);
    }
  }
  return picture;
}

Status Segment::AddFrame(const FrameInput& frame, const Registration& registration, double noise_sigma, const Emit& emit) {
  const Roi needed = RegionOf(registration.view);
  if (!buffer_.extent.Contains(needed)) {
    Roi grown = RoundedOut(Union(buffer_.extent, needed), 16);
    const bool too_wide = grown.width() > kGrowth * needed.width();
    const bool too_high = grown.height() > kGrowth * needed.height();
    if (too_wide || too_high) {
      early_.clear();  // What has been emitted is not accumulated again.
      TREM_RETURN_IF_ERROR(EmitSnapshot(noise_sigma, emit));
      // What lies behind is dropped along the axis of motion only: ground that the ROI sways over stays.
      const Roi kept = RoundedOut(needed, 16);
      if (too_wide) grown = {kept.x0, grown.y0, kept.x1, grown.y1};
      if (too_high) grown = {grown.x0, kept.y0, grown.x1, kept.y1};
    }
    buffer_.MoveTo(grown);
    residuals_.MoveTo(grown);
    if (kept_) kept_->MoveTo(grown);
    place_.Keep(grown);
  }
  const PlanarMap motion = view_.scene_from_sensor.Inverse() * registration.view.scene_from_sensor;
  const Observation whole = ObservationOf(frame, RoiOf(frame), std::max(noise_sigma, registration.residual_rms));
  const Placed placed = TakePlaced(frame, registration, noise_sigma);
  const CornerMatrix own = registration.corner_covariance - placed.covariance;
  const double frames = 1.0 + skipped_;
  const ViewModel model = options_.view_model;
  previous_from_current_ = Displace(PlanarMap{}, roi_, CornerVector(CornerDisplacement(PlanarMap{}, motion, roi_, model) / frames));
  velocity_covariance_ = (covariance_ + own) / (frames * frames);
  const Eigen::Vector2d centre(0.5 * (roi_.x0 + roi_.x1), 0.5 * (roi_.y0 + roi_.y1));
  progress_px_ += kProgressRate * (previous_from_current_ * centre - centre - progress_px_);
  lost_from_current_ = PlanarMap{};
  lost_motion_known_ = true;
  skipped_ = 0;
  view_ = registration.view;
  covariance_ = own;
  // What is unlike the rest of this frame, whose noise may have grown with a gain.
  const Image<float>* const weights = MaskMovers(frame, std::max(noise_sigma, registration.residual_sigma));
  const Observation observation{&frame.pixels, RoiOf(frame), noise_sigma, weights};
  Update(frame, observation, view_, options_.iterations > 0 ? options_.iterations : kFrameIterations);
  place_.Add(placed.texture, place_.Measure(whole, ReferenceNow(SeenMin()), view_), whole, view_, Forgetting());
  KeepForRevisit(frame, weights, registration, noise_sigma);
  return {};
}

}  // namespace trem
