#include "worker/sortie/ingest.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
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
#include "worker/sortie/frame_measures.h"
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

// Usable frames by which the black borders are found; before, no motion can be measured.
constexpr std::size_t kBorderFrames = 32;
// The motion of so many successive frames is measured in one go, without knowledge of what was before them: runs may be measured at once.
constexpr std::size_t kRunFrames = 8;
// Frames under way for each thread: two runs, one that is measured and one that is read meanwhile.
constexpr int kItemsPerThread = 16;
// Frames are measured at once as far as they have no more pixels than this together.
constexpr long long kPixelsAtOnceMax = 1LL << 25;
constexpr double kQuantisationSigma = 0.29;  // Of an integer grey level: 1 / sqrt(12).
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

  // A usable frame whose motion is to be measured.
  struct WaitingFrame {
    int index = 0;
    std::shared_ptr<const Image<float>> reduced;
  };
  // Successive ones.
  struct FrameRun {
    std::shared_ptr<const Image<float>> before;  // The last of the run before; null: none.
    std::vector<WaitingFrame> frames;
    std::vector<std::optional<MotionLink>> links;  // Parallel to frames, once measured.
  };
  // A frame on its way, and a run that was complete when it was accepted; seldom its own.
  struct Item {
    SourceFrame frame;
    FrameMeasures measures;
    FrameRun run;
  };

  // Frames are read, and runs of them linked, at once; each frame is accepted, and each run noted, in its turn.
  Status ReadAndLink() {
    measuring_ = {source_->width_px(), source_->height_px(), std::nullopt, mask_.has_value() ? &*mask_ : nullptr,
                  filler_.has_value() ? &*filler_ : nullptr};
    if (sortie_.sensor().has_saturation_level()) measuring_.saturation_level = sortie_.sensor().saturation_level();
    const long long pixels = static_cast<long long>(source_->width_px()) * source_->height_px();
    const int threads = static_cast<int>(std::clamp<long long>(kPixelsAtOnceMax / std::max(pixels, 1LL), 1, std::max(threads_, 1)));
    using Step = PipelineStep<Item>;
    ForEachItem<Item>(
        threads, threads * kItemsPerThread, [this] { return NextItem(); },
        {{Step::Order::kAtOnce, [this](Item& item) { item.measures = MeasureFrame(std::exchange(item.frame.read, {})(), measuring_); }},
         {Step::Order::kOneByOne, [this](Item& item) { Accept(item); }},
         {Step::Order::kAtOnce, [this](Item& item) { LinkRun(&item.run); }},
         {Step::Order::kOneByOne, [this](Item& item) { NoteLinks(item.run); }}});
    TREM_RETURN_IF_ERROR(read_);
    if (!valid_roi_ && !waiting_.empty()) BeginMotion();
    while (!waiting_.empty()) CompleteRun();
    ForEachIndex(threads_, static_cast<int>(runs_.size()), [this](int index, int) { LinkRun(&runs_[static_cast<std::size_t>(index)]); });
    for (const FrameRun& run : runs_) NoteLinks(run);
    SetLinks();
    if (usable_count_ > 0) return {};
    if (!first_problem_.ok()) return first_problem_.WithPrefix(sortie_.source().path() + ": no frame is usable; the first problem");
    return InvalidInput(sortie_.source().path() + ": no frame is usable: all " + std::to_string(manifest_.frames_size()) +
                        " are blank; expected pictures");
  }

  // Null at the source's end, and where there is no going on: then read_ says why.
  std::unique_ptr<Item> NextItem() {
    const auto expected = static_cast<double>(source_->expected_count());
    // Without a known count the fraction only approaches 1.
    const double fraction = expected > 0.0 ? std::min(1.0, given_count_ / expected) : 1.0 - 1.0 / (1.0 + given_count_ / 500.0);
    if (progress_ && !progress_(fraction)) {
      read_ = Cancelled(sortie_.source().path() + ": ingest was stopped");
      return nullptr;
    }
    auto item = std::make_unique<Item>();
    const Result<bool> more = source_->Next(&item->frame);
    read_ = more.status();
    if (!more.ok() || !*more) return nullptr;
    ++given_count_;
    return item;
  }

  void Accept(Item& item) {
    const int index = manifest_.frames_size();
    v1::ManifestFrame* entry = manifest_.add_frames();
    entry->set_name(item.frame.name);
    entry->set_pts(item.frame.pts);
    entry->set_time_s(item.frame.time_s);
    entry->set_state(Judge(item.frame, item.measures));
    if (!item.measures.read.ok() && first_problem_.ok()) first_problem_ = item.measures.read;
    if (entry->state() == v1::FRAME_USABLE) {
      Gather(item.measures);
      waiting_.push_back({index, std::make_shared<const Image<float>>(std::move(item.measures.reduced))});
    }
    item.measures = {};
    if (!valid_roi_ && waiting_.size() >= kBorderFrames) BeginMotion();
    while (valid_roi_ && waiting_.size() >= kRunFrames) CompleteRun();
    if (runs_.empty()) return;
    item.run = std::move(runs_.front());
    runs_.pop_front();
  }

  v1::FrameState Judge(const SourceFrame& frame, const FrameMeasures& measures) {
    const std::string subject = "frame " + std::to_string(manifest_.frames_size() - 1);
    if (!measures.read.ok()) {
      Note(v1::WARNING, "frame_unreadable", frame.name, subject + ", " + measures.read.message());
      return v1::FRAME_UNREADABLE;
    }
    if (!measures.SizeIs(measuring_)) {
      Note(v1::WARNING, "frame_wrong_size", frame.name,
           subject + ", " + frame.path + ": is " + std::to_string(measures.width_px) + " x " + std::to_string(measures.height_px) +
               " pixels; expected " + std::to_string(source_->width_px()) + " x " + std::to_string(source_->height_px()) +
               " like most frames");
      return v1::FRAME_WRONG_SIZE;
    }
    RememberFingerprint(measures.fingerprint);
    if (measures.blank) {
      Note(v1::WARNING, "frame_blank", frame.name,
           subject + " is blank: its grey levels lie between " + std::to_string(measures.middle.low) + " and " +
               std::to_string(measures.middle.high));
      return v1::FRAME_BLANK;
    }
    if (usable_count_ > 0 && measures.fingerprint == last_fingerprint_) {
      Note(v1::INFO, "frame_repeated", frame.name, subject + " repeats the frame before it bit by bit");
      return v1::FRAME_REPEATED;
    }
    if (usable_count_ > 0 && measures.grey_max != grey_max_) {
      Note(v1::WARNING, "frame_unreadable", frame.name,
           subject + ", " + frame.path + ": its grey levels end at " + std::to_string(measures.grey_max) + "; expected " +
               std::to_string(grey_max_) + " as in the first frame");
      return v1::FRAME_UNREADABLE;
    }
    last_fingerprint_ = measures.fingerprint;
    grey_max_ = measures.grey_max;
    return v1::FRAME_USABLE;
  }

  void Gather(const FrameMeasures& measures) {
    ++usable_count_;
    saturated_count_ += measures.saturated_count;
    borders_->Add(measures.line_means);
    sampler_.Add(measures.sample);
    noise_sigmas_.push_back(measures.noise_sigma);
  }

  // When the borders are known.
  void BeginMotion() {
    valid_roi_ = borders_->Find().valid_roi;
    const double level_max = SaturationLevel().value_or(std::numeric_limits<double>::infinity());
    if (LooksForVignetting()) vignetting_.emplace(source_->width_px(), source_->height_px(), *valid_roi_, kUnsaturatedPart * level_max);
  }

  // Moves frames that wait to a run of their own.
  void CompleteRun() {
    FrameRun run;
    run.before = last_waiting_;
    const auto end = waiting_.begin() + static_cast<std::ptrdiff_t>(std::min(kRunFrames, waiting_.size()));
    run.frames.assign(waiting_.begin(), end);
    waiting_.erase(waiting_.begin(), end);
    last_waiting_ = run.frames.back().reduced;
    runs_.push_back(std::move(run));
  }

  // How the frames of a run lie to the usable ones before them.
  void LinkRun(FrameRun* run) const {
    if (run->frames.empty()) return;
    FrameMotion motion(source_->width_px(), source_->height_px(), *valid_roi_);
    if (run->before != nullptr) (void)motion.Link(*run->before);
    for (const WaitingFrame& frame : run->frames) run->links.push_back(motion.Link(*frame.reduced));
  }

  void NoteLinks(const FrameRun& run) {
    for (std::size_t i = 0; i < run.frames.size(); ++i) {
      const std::optional<MotionLink>& link = run.links[i];
      if (vignetting_.has_value()) {
        vignetting_->Add(*run.frames[i].reduced, link.has_value() ? std::optional<Affine>(link->previous_from_current) : std::nullopt);
      }
      if (link.has_value()) links_.emplace_back(run.frames[i].index, *link);
    }
  }

  void SetLinks() {
    for (const auto& [index, link] : links_) {
      v1::ManifestFrame* entry = manifest_.mutable_frames(index);
      ToProto(link.previous_from_current, entry->mutable_previous_from_current());
      entry->set_motion_correlation(link.correlation);
    }
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
  FrameMeasuring measuring_;
  Status read_;
  double given_count_ = 0.0;  // Frames that the source gave.
  Status first_problem_;
  // Frames and runs whose motion is to be measured, in order.
  std::deque<WaitingFrame> waiting_;
  std::shared_ptr<const Image<float>> last_waiting_;  // The last frame that left waiting_.
  std::deque<FrameRun> runs_;
  std::vector<std::pair<int, MotionLink>> links_;  // With the frame's index.
  std::optional<Roi> valid_roi_;
  std::optional<VignettingFinder> vignetting_;
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
