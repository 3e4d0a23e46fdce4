// What a segment knows of its own place on its plane, and how it mends it: see worker/tre/segment.h.
#include <Eigen/LU>
#include <algorithm>

#include "worker/tre/segment.h"

namespace trem {
namespace {

// Frames after which the first ones are registered again; how far each may move.
constexpr int kRevisitedFrames = 8;
constexpr double kRevisitMotionMaxPx = 0.5;
constexpr std::uint64_t kRevisitStream = std::uint64_t{1} << 32;  // Its random streams are not those of the first time.
constexpr double kMotionSigmaPx = 0.7;
constexpr int kRevisitIterations = 20;

Observation ObservationOfWhole(const FrameInput& frame, const Roi& roi, double noise_sigma) {
  return {&frame.pixels, roi, noise_sigma, frame.weights.empty() ? nullptr : &frame.weights};
}

bool SameView(const View& a, const View& b) {
  const PlanarMap& p = a.scene_from_sensor;
  const PlanarMap& q = b.scene_from_sensor;
  return p.linear == q.linear && p.offset == q.offset && p.perspective == q.perspective && a.gain == b.gain && a.offset == b.offset;
}

}  // namespace

Segment::Placed Segment::PlaceOf(const FrameInput& frame, const Registration& registration, double noise_sigma) const {
  const Observation observation = ObservationOfWhole(frame, RoiOf(frame), std::max(noise_sigma, registration.residual_rms));
  Placed placed{frame.frame_index, observation.noise_sigma, registration.view, {}, {}};
  placed.texture = place_.Measure(observation, ReferenceNow(SeenMin()), registration.view);
  placed.covariance = place_.CovarianceOf(placed.texture, observation, registration.view);
  return placed;
}

Segment::Placed Segment::TakePlaced(const FrameInput& frame, const Registration& registration, double noise_sigma) {
  const std::optional<Placed> placed = std::exchange(placed_, std::nullopt);
  const bool is_it = placed && placed->frame_index == frame.frame_index && SameView(placed->view, registration.view) &&
                     placed->noise_sigma == std::max(noise_sigma, registration.residual_rms);
  return is_it ? *placed : PlaceOf(frame, registration, noise_sigma);
}

void Segment::KeepForRevisit(const FrameInput& frame, const Image<float>* weights, const Registration& registration, double noise_sigma) {
  // Ground that has been made anew is not to be made from what it was.
  if (!movers_.outvoted().empty()) early_.clear();
  if (early_.empty()) return;
  early_.emplace_back(frame, registration);
  if (weights != nullptr) early_.back().first.weights = *weights;
  if (static_cast<int>(early_.size()) == kRevisitedFrames) Revisit(noise_sigma);
}

void Segment::Revisit(double noise_sigma) {
  std::vector<std::pair<FrameInput, Registration>> early = std::exchange(early_, {});
  std::vector<Registration> found;
  for (const auto& [frame, registration] : early) {
    RegistrationRequest request;
    request.prior.mean = registration.view;
    const Eigen::Index n = covariance_.rows();
    request.prior.information = CornerMatrix::Identity(n, n) / (kMotionSigmaPx * kMotionSigmaPx);
    request.method = options_.registration;
    request.gain_offset = options_.gain_offset;
    request.motion_px_max = kRevisitMotionMaxPx;
    request.stream[0] = options_.seed;
    request.stream[1] = segment_id_;
    request.stream[2] = kRevisitStream + static_cast<std::uint64_t>(frame.frame_index);
    const JudgedRegistration judged = Register(ObservationOfWhole(frame, roi_, noise_sigma), ReferenceNow(SeenMin()), request);
    if (!judged.doubt.empty() || judged.registration.overlap < kRegistrationOverlapMin) return;
    found.push_back(judged.registration);
  }
  const View nominal = early.front().second.view;
  const View first = found.front().view;
  const PlanarMap plane_from_scene = nominal.scene_from_sensor * first.scene_from_sensor.Inverse();
  place_.Clear();
  std::fill(buffer_.weight.pixels().begin(), buffer_.weight.pixels().end(), 0.0F);
  std::fill(buffer_.weighted.pixels().begin(), buffer_.weighted.pixels().end(), 0.0F);
  for (std::size_t k = 0; k < found.size(); ++k) {
    View& view = found[k].view;
    view.scene_from_sensor = plane_from_scene * view.scene_from_sensor;
    view.gain /= first.gain;
    view.offset -= view.gain * first.offset;
    const Observation observation = ObservationOfWhole(early[k].first, roi_, noise_sigma);
    if (k == 0) {
      found[k] = early[k].second;
    } else {
      covariance_ = found[k].corner_covariance;
      found[k].corner_covariance += PlaceOf(early[k].first, found[k], noise_sigma).covariance;
    }
    if (kept_) kept_->Revise(early[k].first.frame_index, found[k].view);
    const PlaceField::Texture texture = place_.Measure(observation, ReferenceNow(SeenMin()), view);
    place_.Add(texture, texture, observation, view, 1.0);
    update_.AddFrame(observation, view, Footprint(view.scene_from_sensor), &buffer_);
    // The view is what was found again. The residuals stay those of a frame that the scene did not hold yet: they judge predictions.
    Registration revised = early[k].second;
    revised.view = found[k].view;
    revised.corner_covariance = found[k].corner_covariance;
    revised.gain_offset_covariance = found[k].gain_offset_covariance;
    revised_.push_back({early[k].first.frame_index, revised});
  }
  view_ = found.back().view;
  update_.UpdateSeen(buffer_.extent, options_.ratio, &buffer_);
  Iterate(buffer_.extent, kRevisitIterations, regularisation_.Weight(buffer_.extent, buffer_, noise_sigma));
}

}  // namespace trem
