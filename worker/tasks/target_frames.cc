#include "worker/tasks/target_frames.h"

#include <algorithm>
#include <utility>

#include "proto/codec/convert.h"

namespace trem {
namespace {

// Least correlation of a whole-image registration that is believed as where a ROI has gone.
constexpr double kMotionCorrelationMin = 0.3;

}  // namespace

const char* UnusableReason(v1::FrameState state) {
  switch (state) {
    case v1::FRAME_UNREADABLE: return "could not be read";
    case v1::FRAME_WRONG_SIZE: return "has another size than the sortie's frames";
    case v1::FRAME_BLANK: return "is blank";
    case v1::FRAME_REPEATED: return "repeats the frame before it";
    default: return "is not usable";
  }
}

Result<std::optional<Affine>> BelievedMotion(const v1::ManifestFrame& record) {
  if (record.previous_from_current_size() == 0 || record.motion_correlation() < kMotionCorrelationMin) return std::optional<Affine>{};
  TREM_ASSIGN_OR_RETURN(const Affine motion, AffineFromProto(record.previous_from_current(), "previous_from_current"));
  return std::optional<Affine>(motion);
}

Result<TargetFrame> TargetFrameReader::Read(int index) {
  const bool backwards = index < last_;
  last_ = index;
  if (const auto kept = kept_.find(index); kept != kept_.end()) {
    TargetFrame frame = std::move(kept->second);
    kept_.erase(kept);
    return frame;
  }
  kept_.clear();
  if (!backwards) return ReadOne(index);
  const long long frame_bytes = 4LL * manifest_.width_px() * manifest_.height_px();
  const int run = static_cast<int>(std::clamp<long long>(kKeptBytesMax / std::max<long long>(frame_bytes, 1), 1, 64));
  for (int k = std::max(index - run + 1, frame_begin_); k < index; ++k) {
    TREM_ASSIGN_OR_RETURN(TargetFrame frame, ReadOne(k));
    kept_.emplace(k, std::move(frame));
  }
  return ReadOne(index);
}

Result<TargetFrame> TargetFrameReader::ReadOne(int index) {
  const v1::ManifestFrame& record = manifest_.frames(index);
  TargetFrame frame;
  TREM_ASSIGN_OR_RETURN(frame.previous_from_current, BelievedMotion(record));
  if (record.state() != v1::FRAME_USABLE) {
    frame.skip_reason = UnusableReason(record.state());
    return frame;
  }
  TREM_ASSIGN_OR_RETURN(const Image<float> whole, reader_->Read(index));
  FrameInput taken;
  pixel_use_.Take(whole, {0, 0, whole.width(), whole.height()}, &taken);
  frame.pixels = std::move(taken.pixels);
  frame.weights = std::move(taken.weights);
  return frame;
}

}  // namespace trem
