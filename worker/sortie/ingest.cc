#include "worker/sortie/ingest.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "mosaic/base/parallel.h"
#include "proto/codec/convert.h"
#include "worker/sortie/borders.h"
#include "worker/sortie/control_csv.h"
#include "worker/sortie/frame_motion.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/frame_source.h"
#include "worker/sortie/frame_statistics.h"
#include "worker/sortie/pixel_mask.h"
#include "worker/sortie/spans.h"
#include "worker/sortie/telemetry_attach.h"
#include "worker/sortie/vignetting.h"

namespace trem {
namespace {

// Frames that are read (and looked at for borders) while the motion between those before them is measured; their reduced versions wait.
constexpr std::size_t kBatchFrames = 32;
// The motion of so many successive frames is measured in one go, without knowledge of what was before them: runs may be measured at once.
constexpr std::size_t kRunFrames = 8;
constexpr double kQuantisationSigma = 0.29;  // Of an integer grey level: 1 / sqrt(12).
constexpr double kBlankSpan = 2.0;           // Grey levels of an 8-bit source.
// More saturated pixels than this are worth a note.
constexpr double kSaturatedPartNoted = 0.01;
constexpr std::size_t kFingerprintsMax = 16;
// Of the saturation level: a mean over pixels below it holds no saturated one that matters.
constexpr double kUnsaturatedPart = 0.97;

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

class Ingest {
 public:
  Ingest(const v1::Sortie& sortie, const std::function<bool(double)>& progress, int threads)
      : sortie_(sortie), progress_(progress), threads_(threads) {}

  Result<v1::SortieManifest> Run() {
    TREM_ASSIGN_OR_RETURN(source_, OpenFrameSource(sortie_));
    StartManifest();
    // Telemetry first: a bad file should be reported before an hour of decoding.
    TREM_ASSIGN_OR_RETURN(const FoundTelemetry telemetry, FindTelemetry(sortie_, source_->width_px(), source_->height_px()));
    TREM_ASSIGN_OR_RETURN(mask_, ReadPixelMask(sortie_.sensor(), source_->width_px(), source_->height_px()));
    if (mask_.has_value()) filler_.emplace(*mask_);
    TREM_RETURN_IF_ERROR(ReadAndLink());
    FinishPixels();
    FinishVignetting();
    TREM_RETURN_IF_ERROR(CheckSeeking());
    for (const v1::Note& note : source_->notes()) *manifest_.add_notes() = note;
    TREM_RETURN_IF_ERROR(AttachFoundTelemetry(telemetry, sortie_, &manifest_));
    TREM_RETURN_IF_ERROR(AttachControl(sortie_.control(), &manifest_));
    SplitIntoSpans(&manifest_);
    return std::move(manifest_);
  }

 private:
  void Note(v1::Severity severity, const std::string& code, const std::string& subject, const std::string& message) {
    *manifest_.add_notes() = MakeNote(severity, code, subject, message);
  }

  void StartManifest() {
    manifest_.set_source_path(sortie_.source().path());
    manifest_.set_source_kind(source_->kind());
    manifest_.set_width_px(static_cast<std::uint32_t>(source_->width_px()));
    manifest_.set_height_px(static_cast<std::uint32_t>(source_->height_px()));
    manifest_.set_deinterlaced(source_->deinterlaced());
    borders_.emplace(source_->width_px(), source_->height_px());
  }

  // The next frames are read while the ones before are linked.
  Status ReadAndLink() {
    std::vector<WaitingFrame> batch;
    do {
      batch = std::exchange(waiting_, {});
      if (!batch.empty() && !valid_roi_) BeginMotion();
      const int runs = static_cast<int>((batch.size() + kRunFrames - 1) / kRunFrames);
      std::vector<std::optional<MotionLink>> links(batch.size());
      Status read;
      ForEachIndex(threads_, runs + 1, [&](int index, int) {
        if (index == 0) {
          read = ReadBatch();
        } else {
          const auto run = static_cast<std::size_t>(index) - 1;
          LinkRun(batch, run * kRunFrames, &links);
        }
      });
      TREM_RETURN_IF_ERROR(read);
      for (std::size_t i = 0; i < batch.size(); ++i) SetLink(batch[i], links[i]);
      if (!batch.empty()) last_linked_ = std::move(batch.back().reduced);
    } while (!waiting_.empty());
    if (usable_count_ > 0) return {};
    if (!first_problem_.ok()) return first_problem_.WithPrefix(sortie_.source().path() + ": no frame is usable; the first problem");
    return InvalidInput(sortie_.source().path() + ": no frame is usable: all " + std::to_string(manifest_.frames_size()) +
                        " are blank; expected pictures");
  }

  // Until enough usable frames wait, or the source ends.
  Status ReadBatch() {
    SourceFrame frame;
    while (!has_ended_ && waiting_.size() < kBatchFrames) {
      const int index = manifest_.frames_size();
      const auto expected = static_cast<double>(source_->expected_count());
      // Without a known count the fraction only approaches 1.
      const double fraction = expected > 0.0 ? std::min(1.0, index / expected) : 1.0 - 1.0 / (1.0 + index / 500.0);
      if (progress_ && !progress_(fraction)) return Cancelled(sortie_.source().path() + ": ingest was stopped");
      TREM_ASSIGN_OR_RETURN(const bool more, source_->Next(&frame));
      has_ended_ = !more;
      if (has_ended_) break;
      v1::ManifestFrame* entry = manifest_.add_frames();
      entry->set_name(frame.name);
      entry->set_pts(frame.pts);
      entry->set_time_s(frame.time_s);
      entry->set_state(Judge(frame));
      if (!frame.image.ok() && first_problem_.ok()) first_problem_ = frame.image.status();
      if (entry->state() == v1::FRAME_USABLE) Measure(index, std::move(frame.image->pixels));
    }
    return {};
  }

  v1::FrameState Judge(const SourceFrame& frame) {
    const std::string subject = "frame " + std::to_string(manifest_.frames_size() - 1);
    if (!frame.image.ok()) {
      Note(v1::WARNING, "frame_unreadable", frame.name, subject + ", " + frame.image.status().message());
      return v1::FRAME_UNREADABLE;
    }
    const GreyImage& image = *frame.image;
    if (image.pixels.width() != source_->width_px() || image.pixels.height() != source_->height_px()) {
      Note(v1::WARNING, "frame_wrong_size", frame.name,
           subject + ", " + frame.path + ": is " + std::to_string(image.pixels.width()) + " x " + std::to_string(image.pixels.height()) +
               " pixels; expected " + std::to_string(source_->width_px()) + " x " + std::to_string(source_->height_px()) +
               " like most frames");
      return v1::FRAME_WRONG_SIZE;
    }
    const std::uint64_t fingerprint = PixelFingerprint(image.pixels);
    RememberFingerprint(fingerprint);
    const ValueRange range = MiddleRange(image.pixels);
    if (range.high - range.low <= (image.grey_max == 255.0 ? kBlankSpan : 0.0)) {
      Note(v1::WARNING, "frame_blank", frame.name,
           subject + " is blank: its grey levels lie between " + std::to_string(range.low) + " and " + std::to_string(range.high));
      return v1::FRAME_BLANK;
    }
    if (usable_count_ > 0 && fingerprint == last_fingerprint_) {
      Note(v1::INFO, "frame_repeated", frame.name, subject + " repeats the frame before it bit by bit");
      return v1::FRAME_REPEATED;
    }
    if (usable_count_ > 0 && image.grey_max != grey_max_) {
      Note(v1::WARNING, "frame_unreadable", frame.name,
           subject + ", " + frame.path + ": its grey levels end at " + std::to_string(image.grey_max) + "; expected " +
               std::to_string(grey_max_) + " as in the first frame");
      return v1::FRAME_UNREADABLE;
    }
    last_fingerprint_ = fingerprint;
    grey_max_ = image.grey_max;
    return v1::FRAME_USABLE;
  }

  void Measure(int index, Image<float> pixels) {
    ++usable_count_;
    const std::optional<double> saturation = SaturationLevel();
    if (saturation.has_value()) {
      const auto level = static_cast<float>(*saturation);
      saturated_count_ += std::count_if(pixels.pixels().begin(), pixels.pixels().end(), [level](float value) { return value >= level; });
    }
    if (filler_.has_value()) filler_->Fill(&pixels);
    borders_->Add(pixels);
    sampler_.Add(pixels);
    const Roi middle = {pixels.width() / 10, pixels.height() / 10, pixels.width() - pixels.width() / 10,
                        pixels.height() - pixels.height() / 10};
    noise_sigmas_.push_back(EstimateNoiseSigma(pixels, middle, mask_.has_value() ? &mask_->usable : nullptr));
    waiting_.push_back({index, ReduceFrame(pixels)});
  }

  struct WaitingFrame {
    int index = 0;
    Image<float> reduced;
  };
  // When the borders are known.
  void BeginMotion() {
    valid_roi_ = borders_->Find().valid_roi;
    const double level_max = SaturationLevel().value_or(std::numeric_limits<double>::infinity());
    if (LooksForVignetting()) vignetting_.emplace(source_->width_px(), source_->height_px(), *valid_roi_, kUnsaturatedPart * level_max);
  }

  // How the frames of a run lie to the usable ones before them.
  void LinkRun(const std::vector<WaitingFrame>& batch, std::size_t begin, std::vector<std::optional<MotionLink>>* links) const {
    FrameMotion motion(source_->width_px(), source_->height_px(), *valid_roi_);
    const Image<float>& before = begin > 0 ? batch[begin - 1].reduced : last_linked_;
    if (!before.empty()) (void)motion.Link(before);
    for (std::size_t i = begin; i < std::min(begin + kRunFrames, batch.size()); ++i) (*links)[i] = motion.Link(batch[i].reduced);
  }

  void SetLink(const WaitingFrame& frame, const std::optional<MotionLink>& link) {
    if (vignetting_.has_value())
      vignetting_->Add(frame.reduced, link.has_value() ? std::optional<Affine>(link->previous_from_current) : std::nullopt);
    if (!link.has_value()) return;
    v1::ManifestFrame* entry = manifest_.mutable_frames(frame.index);
    ToProto(link->previous_from_current, entry->mutable_previous_from_current());
    entry->set_motion_correlation(link->correlation);
  }

  // Levels of a factor on the light have a zero: those of integer sources, or of others on request.
  bool LooksForVignetting() const {
    const v1::Correction asked = sortie_.sensor().vignetting();
    return asked == v1::CORRECTION_ON || (asked == v1::CORRECTION_AUTO && grey_max_ > 0.0);
  }

  void FinishVignetting() {
    if (!vignetting_.has_value()) return;
    const bool asked = sortie_.sensor().vignetting() == v1::CORRECTION_ON;
    const std::optional<VignettingEstimate> found = vignetting_->Find();
    if (!found.has_value() || !(asked || found->Seen())) {
      if (asked) {
        Note(v1::WARNING, "vignetting_unknown", sortie_.source().path(),
             "vignetting cannot be estimated: too few frames show the same ground at different places of the image");
      }
      return;
    }
    v1::VignettingMessage* vignetting = manifest_.mutable_sensor()->mutable_vignetting();
    vignetting->set_second(found->vignetting.second);
    vignetting->set_fourth(found->vignetting.fourth);
    vignetting->set_corner_error(found->corner_error);
    const double corner = found->vignetting.Corner();
    Note(v1::INFO, "vignetting", sortie_.source().path(),
         fmt::format("the corners of the image are {:.1f} +- {:.2f} % {} than its centre, as {} pairs of frames of the same ground show; "
                     "every frame is divided by that",
                     100.0 * std::abs(1.0 - corner), 100.0 * corner * found->corner_error, corner < 1.0 ? "darker" : "brighter",
                     found->pair_count));
  }

  // Grey level from which a pixel is saturated; nothing for floating point without sensor.saturation_level.
  std::optional<double> SaturationLevel() const {
    if (sortie_.sensor().has_saturation_level()) return sortie_.sensor().saturation_level();
    return grey_max_ > 0.0 ? std::optional<double>(grey_max_) : std::nullopt;
  }

  void FinishMask(BorderFinder::Finding* borders) {
    v1::SensorManifest* sensor = manifest_.mutable_sensor();
    const double pixel_count = static_cast<double>(source_->width_px()) * source_->height_px();
    const std::optional<double> saturation = SaturationLevel();
    if (saturation.has_value()) {
      sensor->set_saturation_level(*saturation);
      const double part = static_cast<double>(saturated_count_) / (pixel_count * usable_count_);
      if (part > kSaturatedPartNoted) {
        Note(v1::INFO, "saturated", sortie_.source().path(),
             fmt::format("{:.1f} % of the pixels are saturated (grey level {:g} or more) and hardly count", 100.0 * part, *saturation));
      }
    }
    if (!mask_.has_value()) return;
    for (const std::uint32_t run : RunsOf(*mask_)) sensor->add_unusable_runs(run);
    borders->valid_roi = Intersect(borders->valid_roi, mask_->usable_bounds);
    Note(v1::INFO, "pixels_masked", sortie_.source().path(),
         fmt::format("{} pixels of the sensor ({:.2f} %) are masked or bad and never used", mask_->unusable_count,
                     100.0 * static_cast<double>(mask_->unusable_count) / pixel_count));
  }

  void FinishPixels() {
    BorderFinder::Finding borders = borders_->Find();
    FinishMask(&borders);
    *manifest_.mutable_valid_roi() = ToProto(borders.valid_roi);
    if (!borders.note.empty()) {
      Note(v1::INFO, "border_cut", sortie_.source().path(),
           "black borders are left out: " + borders.note + "; the picture is " + ToString(borders.valid_roi));
    }
    const double area = static_cast<double>(source_->width_px()) * source_->height_px();
    const GreyScaling scaling = ChooseGreyScaling(grey_max_, sampler_, 1.0 - static_cast<double>(borders.valid_roi.area()) / area);
    manifest_.set_grey_offset(scaling.offset);
    manifest_.set_grey_scale(scaling.scale);
    manifest_.set_grey_max(grey_max_);
    manifest_.mutable_sensor()->set_grey_median(sampler_.Quantile(0.5, 1.0 - static_cast<double>(borders.valid_roi.area()) / area));
    double sigma = sortie_.sensor().noise_sigma();
    if (sigma <= 0.0) {
      sigma = Median(noise_sigmas_);
      // Compression and saturation can make noise invisible, but not smaller than a step of the number type.
      sigma = std::max(sigma, grey_max_ > 0.0 ? kQuantisationSigma : 1e-3 * scaling.scale);
    }
    manifest_.set_noise_sigma(sigma / scaling.scale);
  }

  // Keeps the fingerprints of at most kFingerprintsMax evenly spread frames.
  void RememberFingerprint(std::uint64_t fingerprint) {
    const int index = manifest_.frames_size() - 1;
    if (index % fingerprint_stride_ != 0) return;
    fingerprints_.push_back({index, fingerprint});
    if (fingerprints_.size() <= kFingerprintsMax) return;
    fingerprint_stride_ *= 2;
    std::erase_if(fingerprints_, [this](const Fingerprint& kept) { return kept.index % fingerprint_stride_ != 0; });
  }

  // Reads some frames of a video again, by seeking: where that gives other pixels than the pass from the start did, readers must count
  // from the start.
  Status CheckSeeking() {
    if (manifest_.source_kind() != v1::VIDEO || fingerprints_.size() < 3) return {};
    TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest_));
    const std::size_t last = fingerprints_.size() - 1;
    for (const std::size_t i : {last, last / 2, last * 3 / 4}) {
      const Result<Image<float>> pixels = reader->Read(fingerprints_[i].index);
      if (pixels.ok() && PixelFingerprint(*pixels) == fingerprints_[i].fingerprint) continue;
      manifest_.set_video_from_start(true);
      Note(v1::INFO, "video_seek_inexact", sortie_.source().path(),
           "seeking does not lead back to the same pixels; frames are counted from the start of the file, which is slower");
      return {};
    }
    return {};
  }

  struct Fingerprint {
    int index = 0;
    std::uint64_t fingerprint = 0;
  };

  const v1::Sortie& sortie_;
  const std::function<bool(double)>& progress_;
  const int threads_;
  std::unique_ptr<FrameSource> source_;
  v1::SortieManifest manifest_;
  std::optional<BorderFinder> borders_;
  std::optional<PixelMask> mask_;
  std::optional<MaskFiller> filler_;
  long long saturated_count_ = 0;
  QuantileSampler sampler_;
  std::vector<double> noise_sigmas_;
  bool has_ended_ = false;  // The source.
  Status first_problem_;
  std::vector<WaitingFrame> waiting_;
  std::optional<Roi> valid_roi_;
  std::optional<VignettingFinder> vignetting_;
  Image<float> last_linked_;  // Empty: none.
  int usable_count_ = 0;
  double grey_max_ = 0.0;
  std::uint64_t last_fingerprint_ = 0;
  int fingerprint_stride_ = 1;
  std::vector<Fingerprint> fingerprints_;
};

}  // namespace

Result<v1::SortieManifest> IngestSortie(const v1::Sortie& sortie, const std::function<bool(double fraction)>& progress, int threads) {
  cv::setNumThreads(1);
  return Ingest(sortie, progress, threads).Run();
}

v1::IngestSummary SummariseManifest(const v1::SortieManifest& manifest) {
  v1::IngestSummary summary;
  summary.set_frame_count(static_cast<std::uint32_t>(manifest.frames_size()));
  summary.set_width_px(manifest.width_px());
  summary.set_height_px(manifest.height_px());
  *summary.mutable_valid_roi() = manifest.valid_roi();
  *summary.mutable_spans() = manifest.spans();
  std::uint32_t usable = 0;
  std::vector<double> motions_px;
  const Eigen::Vector2d centre(0.5 * (manifest.width_px() - 1.0), 0.5 * (manifest.height_px() - 1.0));
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    usable += frame.state() == v1::FRAME_USABLE ? 1 : 0;
    const Result<Affine> motion = AffineFromProto(frame.previous_from_current(), "previous_from_current");
    if (frame.motion_correlation() > 0.0 && motion.ok()) motions_px.push_back(((*motion) * centre - centre).norm());
  }
  summary.set_usable_frame_count(usable);
  summary.set_median_motion_px(Median(std::move(motions_px)));
  return summary;
}

}  // namespace trem
