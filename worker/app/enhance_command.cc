#include "worker/app/enhance_command.h"
#include "mosaic/base/exit_code.h"

#include <fmt/format.h>
#include <signal.h>
#include <stdlib.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/file.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_spec.h"
#include "worker/app/enhance_outputs.h"
#include "worker/app/progress_bar.h"
#include "worker/app/usage.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

constexpr int kExitInterrupted = 130;
// Bounds of one run: side of a ROI, frames, and pixels of all the ROIs together (2 GiB of float32).
constexpr int kRoiSideMin = 16;
constexpr int kRoiSideMax = 1024;
constexpr int kFramesMax = 4096;
constexpr long long kPixelsMax = 1LL << 29;
constexpr int kNumberMax = 1'000'000'000;

constexpr const char* kExamples =
    "\nLeaves scene.tif (bands: intensity, its standard deviation, information, residual; its geotransform leads to sensor pixels of the "
    "reference frame, from the frame's upper left corner, y down), scene_chain.csv (how every frame was registered), "
    "scene_comparison.png (left the reference frame, right the scene) and scene_report.html (pictures and plots of all this).\n"
    "\nExamples:\n"
    "  trem enhance flight.ts -o scene.tif                                the centre of the image, the first frames\n"
    "  trem enhance frames/ --roi 40,30,151,151 --frames 0:60 -o scene.tif\n"
    "  trem enhance sortie.textproto --set tre.ratio=2 --reference 59 -o scene.tif\n"
    "  trem enhance flight.ts --roi 322,190,72,60 --reference 20 --track -o car.tif   follow what is there in frame 20\n"
    "\nExit codes: 0 done, 1 failed, 2 usage, 3 invalid input, 130 interrupted\n";

struct FrameRange {
  int begin = 0;
  int end = 0;
};

struct Arguments {
  std::string sortie;
  std::optional<Roi> roi;
  std::optional<FrameRange> frames;
  std::optional<int> reference;
  std::vector<std::string> overrides;
  std::string output;
  int threads = 0;  // 0: all cores.
  int resolution_frames = 64;
  bool track = false;
  bool json = false;
  bool quiet = false;
};

std::atomic<bool> stop_requested{false};

void OnStopSignal(int) { stop_requested = true; }

// While one lives, SIGINT and SIGTERM ask to stop, so that the temporary folder is removed.
class StopOnSignal {
 public:
  StopOnSignal() {
    stop_requested = false;
    struct sigaction action = {};
    action.sa_handler = OnStopSignal;
    ::sigaction(SIGINT, &action, &interrupt_);
    ::sigaction(SIGTERM, &action, &terminate_);
  }
  ~StopOnSignal() {
    ::sigaction(SIGINT, &interrupt_, nullptr);
    ::sigaction(SIGTERM, &terminate_, nullptr);
  }
  StopOnSignal(const StopOnSignal&) = delete;
  StopOnSignal& operator=(const StopOnSignal&) = delete;

 private:
  struct sigaction interrupt_ = {};
  struct sigaction terminate_ = {};
};

// A folder in the system's place for temporary files, removed with its content at the end.
class ScratchFolder {
 public:
  static Result<ScratchFolder> Make() {
    std::error_code error;
    std::string name = (fs::temp_directory_path(error) / "trem-enhance-XXXXXX").string();
    if (error) return Failed("there is no folder for temporary files: " + error.message() + "; set TMPDIR");
    if (::mkdtemp(name.data()) == nullptr) return FromErrno("cannot make the temporary folder " + name + " (TMPDIR says where)", errno);
    return ScratchFolder(name);
  }
  ScratchFolder(ScratchFolder&& other) noexcept : path_(std::move(other.path_)) { other.path_.clear(); }
  ScratchFolder& operator=(ScratchFolder&&) = delete;
  ~ScratchFolder() {
    std::error_code ignored;
    if (!path_.empty()) fs::remove_all(path_, ignored);
  }
  const fs::path& path() const { return path_; }

 private:
  explicit ScratchFolder(fs::path path) : path_(std::move(path)) {}
  fs::path path_;
};

// Exactly `count` whole numbers, 0 .. kNumberMax, between separators; nothing else.
std::optional<std::vector<int>> ParseNumbers(std::string_view text, char separator, std::size_t count) {
  std::vector<int> numbers;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  while (numbers.size() < count) {
    if (!numbers.empty() && (at == end || *at++ != separator)) return std::nullopt;
    int number = 0;
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc{} || number < 0 || number > kNumberMax) return std::nullopt;
    numbers.push_back(number);
    at = next;
  }
  if (at != end) return std::nullopt;
  return numbers;
}

void SetRoi(const std::string& text, Arguments* arguments) {
  const auto numbers = ParseNumbers(text, ',', 4);
  if (!numbers) {
    throw CLI::ValidationError("--roi",
                               "'" + text + "' is not a rectangle; expected x,y,width,height in sensor pixels, for example 40,30,151,151");
  }
  const std::vector<int>& n = *numbers;
  arguments->roi = Roi{n[0], n[1], n[0] + n[2], n[1] + n[3]};
}

void SetFrames(const std::string& text, Arguments* arguments) {
  const auto numbers = ParseNumbers(text, ':', 2);
  if (!numbers || (*numbers)[0] >= (*numbers)[1]) {
    throw CLI::ValidationError("--frames",
                               "'" + text + "' is not a range of frames; expected first:end, end not included, for example 0:60");
  }
  arguments->frames = FrameRange{(*numbers)[0], (*numbers)[1]};
}

Status CheckOutput(const std::string& output) {
  const fs::path path(output);
  if (path.extension() != ".tif" && path.extension() != ".tiff") {
    return InvalidInput("-o " + output + ": the scene is a GeoTIFF; expected a name that ends in .tif");
  }
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) return InvalidInput("-o " + output + " is a folder; expected the name of a file");
  return CheckWritable(path.parent_path());
}

// Before anything is read: what cannot be right whatever the sortie holds.
Status CheckArguments(const Arguments& arguments) {
  TREM_RETURN_IF_ERROR(CheckOutput(arguments.output));
  if (arguments.roi) {
    const Roi& roi = *arguments.roi;
    if (std::min(roi.width(), roi.height()) < kRoiSideMin || std::max(roi.width(), roi.height()) > kRoiSideMax) {
      return InvalidInput(fmt::format("--roi: the ROI is {} x {} sensor pixels; expected sides of {} to {}", roi.width(), roi.height(),
                                      kRoiSideMin, kRoiSideMax));
    }
  }
  if (arguments.track && arguments.frames && arguments.reference &&
      (*arguments.reference < arguments.frames->begin || *arguments.reference >= arguments.frames->end)) {
    return InvalidInput(fmt::format("--reference {}: the target is picked in one of the frames used, {}:{}", *arguments.reference,
                                    arguments.frames->begin, arguments.frames->end));
  }
  if (arguments.frames && arguments.frames->end - arguments.frames->begin > kFramesMax) {
    return InvalidInput(fmt::format("--frames: {} frames are more than one scene is made from; choose at most {}",
                                    arguments.frames->end - arguments.frames->begin, kFramesMax));
  }
  return {};
}

// Frames that need not be looked at are not ingested, and telemetry plays no part.
Result<v1::Sortie> LoadWhatIsNeeded(const Arguments& arguments) {
  TREM_ASSIGN_OR_RETURN(v1::Sortie sortie, LoadSortie(arguments.sortie, arguments.overrides));
  const std::uint32_t needed = static_cast<std::uint32_t>(arguments.frames ? arguments.frames->end : kFramesMax);
  const std::uint32_t asked = sortie.source().max_frames();
  sortie.mutable_source()->set_max_frames(asked == 0 ? needed : std::min(asked, needed));
  sortie.mutable_telemetry()->set_ignore(true);
  return sortie;
}

Result<v1::TaskResult> RunWithProgress(const std::string& label, const Arguments& arguments, const ArtefactStore& store,
                                       const v1::TaskSpec& spec) {
  ProgressBar bar(label, arguments.quiet);
  TaskContext context{&store, [&bar](double fraction) {
                        bar.Show(fraction);
                        return !stop_requested;
                      }};
  context.threads = arguments.threads > 0 ? arguments.threads : std::max(static_cast<int>(std::thread::hardware_concurrency()), 1);
  return RunTask(spec, context);
}

Result<Roi> ChooseRoi(const Arguments& arguments, const v1::Sortie& sortie, const v1::SortieManifest& manifest) {
  const Roi sensor{0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  if (arguments.roi) {
    if (sensor.Contains(*arguments.roi)) return *arguments.roi;
    return InvalidInput(fmt::format("--roi: {} is not inside the frames, which are {} x {} pixels", ToString(*arguments.roi),
                                    sensor.width(), sensor.height()));
  }
  const Roi valid = Intersect(FromProto(manifest.valid_roi()), sensor);
  const int side = static_cast<int>(sortie.windows().roi_px());
  const int width = std::min(valid.width(), side);
  const int height = std::min(valid.height(), side);
  if (std::min(width, height) < kRoiSideMin) {
    return InvalidInput(fmt::format("the frames without their black borders are {} x {} pixels; at least {} x {} are needed", valid.width(),
                                    valid.height(), kRoiSideMin, kRoiSideMin));
  }
  const int x0 = valid.x0 + (valid.width() - width) / 2;
  const int y0 = valid.y0 + (valid.height() - height) / 2;
  return Roi{x0, y0, x0 + width, y0 + height};
}

Result<FrameRange> ChooseFrames(const Arguments& arguments, const Roi& roi, const v1::SortieManifest& manifest,
                                std::vector<std::string>* notes) {
  const int frame_count = manifest.frames_size();
  // Following a target reads one frame at a time.
  const int affordable = arguments.track ? kFramesMax : static_cast<int>(std::min<long long>(kFramesMax, kPixelsMax / roi.area()));
  if (arguments.frames) {
    const FrameRange& frames = *arguments.frames;
    if (frames.end > frame_count) {
      return InvalidInput(fmt::format("--frames {}:{}: {} has {} frames; choose a range in 0:{}", frames.begin, frames.end,
                                      manifest.source_path(), frame_count, frame_count));
    }
    if (frames.end - frames.begin > affordable) {
      return InvalidInput(
          fmt::format("--frames: {} frames of a ROI of {} x {} pixels need too much memory; choose at most {} or a smaller --roi",
                      frames.end - frames.begin, roi.width(), roi.height(), affordable));
    }
    return frames;
  }
  if (manifest.spans_size() == 0) return InvalidInput(manifest.source_path() + " has no usable run of frames; see trem inspect");
  const v1::FrameSpan* span = &manifest.spans(0);
  for (const v1::FrameSpan& other : manifest.spans()) {
    const std::uint32_t wanted = static_cast<std::uint32_t>(arguments.reference.value_or(0));
    if (arguments.track && arguments.reference && other.begin() <= wanted && wanted < other.end()) span = &other;
  }
  FrameRange frames{static_cast<int>(span->begin()), static_cast<int>(span->end())};
  if (frames.end - frames.begin >= affordable) {
    frames.end = frames.begin + affordable;
    notes->push_back(fmt::format("only frames {}:{} were used; choose others with --frames", frames.begin, frames.end));
  }
  return frames;
}

// The frame in which the target was picked.
Result<int> ChooseTargetFrame(const Arguments& arguments, const FrameRange& frames, const v1::SortieManifest& manifest) {
  if (!arguments.reference) {
    for (int k = frames.begin; k < frames.end; ++k) {
      if (manifest.frames(k).state() == v1::FRAME_USABLE) return k;
    }
    return InvalidInput(fmt::format("--frames {}:{}: none of these frames is usable; see trem inspect", frames.begin, frames.end));
  }
  if (*arguments.reference >= frames.begin && *arguments.reference < frames.end) return *arguments.reference;
  return InvalidInput(fmt::format("--reference {}: the target is picked in one of the frames used, {}:{}; choose others with --frames",
                                  *arguments.reference, frames.begin, frames.end));
}

// The window's task for fewer frames of it, without what only the published scene needs.
Result<v1::WindowResult> EnhanceAlone(const Arguments& arguments, const ArtefactStore& store, v1::TaskSpec task, int begin, int end,
                                      const Roi& roi, std::optional<int> target) {
  *task.mutable_enhance()->mutable_roi_in_sensor() = ToProto(roi);
  task.mutable_enhance()->set_frame_begin(static_cast<std::uint32_t>(begin));
  task.mutable_enhance()->set_frame_end(static_cast<std::uint32_t>(end));
  task.mutable_enhance()->set_uncertainty(false);
  // A prior that knows edges draws the same ones into both halves.
  task.mutable_sortie()->mutable_tre()->set_structure(v1::MEMBRANE);
  if (target) task.mutable_enhance()->set_target_picked_in_frame(static_cast<std::uint32_t>(*target));
  TREM_ASSIGN_OR_RETURN(const v1::TaskResult result,
                        RunWithProgress(fmt::format("resolution of {} frames", end - begin), arguments, store, task));
  TREM_CHECK(result.outputs_size() >= 1);
  v1::WindowResult window;
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(store, result.outputs(0), &window));
  return window;
}

struct Outcome {
  Roi roi;
  FrameRange frames;
  bool target = false;
  EnhanceSummary summary;
};

Result<Outcome> Enhance(const Arguments& arguments) {
  TREM_RETURN_IF_ERROR(CheckArguments(arguments));
  v1::TaskSpec ingest;
  ingest.set_kind(v1::INGEST);
  TREM_ASSIGN_OR_RETURN(*ingest.mutable_sortie(), LoadWhatIsNeeded(arguments));
  TREM_ASSIGN_OR_RETURN(const ScratchFolder scratch, ScratchFolder::Make());
  TREM_ASSIGN_OR_RETURN(const ArtefactStore store, ArtefactStore::Open(scratch.path()));

  TREM_ASSIGN_OR_RETURN(const v1::TaskResult ingested, RunWithProgress("reading", arguments, store, ingest));
  TREM_CHECK(ingested.outputs_size() >= 1);
  v1::SortieManifest manifest;
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(store, ingested.outputs(0), &manifest));

  Outcome outcome;
  outcome.target = arguments.track;
  std::vector<std::string> notes;
  for (const v1::Note& note : manifest.notes()) {
    if (note.severity() == v1::WARNING || note.code() == "resolution_ceiling" || note.code() == "psf_estimate")
      notes.push_back(note.message());
  }
  TREM_ASSIGN_OR_RETURN(outcome.roi, ChooseRoi(arguments, ingest.sortie(), manifest));
  TREM_ASSIGN_OR_RETURN(outcome.frames, ChooseFrames(arguments, outcome.roi, manifest, &notes));

  v1::TaskSpec enhance;
  enhance.set_kind(v1::ENHANCE);
  enhance.set_seed(ingest.sortie().seed());
  *enhance.mutable_sortie() = ingest.sortie();
  *enhance.add_inputs() = ingested.outputs(0);
  *enhance.mutable_enhance()->mutable_roi_in_sensor() = ToProto(outcome.roi);
  enhance.mutable_enhance()->set_frame_begin(static_cast<std::uint32_t>(outcome.frames.begin));
  enhance.mutable_enhance()->set_frame_end(static_cast<std::uint32_t>(outcome.frames.end));
  enhance.mutable_enhance()->set_uncertainty(true);
  std::optional<int> reference = arguments.reference;
  if (arguments.track) {
    TREM_ASSIGN_OR_RETURN(reference, ChooseTargetFrame(arguments, outcome.frames, manifest));
    enhance.mutable_enhance()->set_target_picked_in_frame(static_cast<std::uint32_t>(*reference));
  }
  TREM_ASSIGN_OR_RETURN(const v1::TaskResult enhanced, RunWithProgress("enhancing", arguments, store, enhance));
  TREM_CHECK(enhanced.outputs_size() >= 1);
  for (const v1::Note& note : enhanced.notes()) notes.push_back(NoteText(note));
  v1::WindowResult window;
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(store, enhanced.outputs(0), &window));
  const EnhancedWindow made{&manifest, &window, &store, static_cast<int>(ingest.sortie().tre().ratio())};
  const EnhanceFrames enhance_alone = [&](int begin, int end, const Roi& roi, std::optional<int> target) {
    return EnhanceAlone(arguments, store, enhance, begin, end, roi, target);
  };
  TREM_ASSIGN_OR_RETURN(outcome.summary,
                        PublishEnhancedScene(made, reference, arguments.output, arguments.resolution_frames, enhance_alone));
  outcome.summary.notes.insert(outcome.summary.notes.begin(), notes.begin(), notes.end());
  return outcome;
}

void PrintJson(const Outcome& outcome) {
  const EnhanceSummary& s = outcome.summary;
  nlohmann::ordered_json json;
  json["roi"] = {outcome.roi.x0, outcome.roi.y0, outcome.roi.width(), outcome.roi.height()};
  json["frames"] = {{"begin", outcome.frames.begin},
                    {"end", outcome.frames.end},
                    {"registered", s.registered_count},
                    {"lost", s.lost_count},
                    {"skipped", s.skipped_count}};
  json["target"] = outcome.target;
  json["segments"] = s.segment_count;
  json["reference"] = {{"index", s.reference_index}, {"frame", s.reference_name}};
  json["noise_sigma"] = s.noise_sigma;
  json["resolution"] = nlohmann::ordered_json::array();
  for (const ResolutionPoint& point : s.resolution) {
    json["resolution"].push_back({{"frames", point.frame_count}, {"cycles_per_px", point.cycles_per_px}});
  }
  for (const fs::path& path : s.outputs) json["outputs"].push_back(path.string());
  json["notes"] = s.notes;
  fmt::print("{}\n", json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

void PrintSummary(const Outcome& outcome) {
  const EnhanceSummary& s = outcome.summary;
  fmt::print("{}: ROI {} of frames {}:{}, {} of {} registered ({} lost, {} skipped), reference frame {} ({})\n", s.outputs[0].string(),
             ToString(outcome.roi), outcome.frames.begin, outcome.frames.end, s.registered_count, s.frame_count, s.lost_count,
             s.skipped_count, s.reference_index, s.reference_name);
  fmt::print("beside it: {}, {}, {}\n", s.outputs[1].filename().string(), s.outputs[2].filename().string(),
             s.outputs[3].filename().string());
}

void Declare(CLI::App* app, Arguments* arguments) {
  app->add_option("SORTIE", arguments->sortie, "A video, a folder or glob of images, or a spec (.textproto, .json)")->required();
  app->add_option("-o,--output", arguments->output, "The scene to write, *.tif; its siblings go beside it")->required();
  CLI::Option* const roi = app->add_option_function<std::string>(
                                  "--roi", [arguments](const std::string& text) { SetRoi(text, arguments); },
                                  "x,y,width,height in sensor pixels: fixed in the sensor, or with --track a target in the reference "
                                  "frame. Default: the image's "
                                  "centre, windows.roi_px a side")
                               ->type_name("X,Y,W,H");
  app->add_flag("--track", arguments->track,
                "Follow the target that --roi frames in the reference frame, forwards and backwards, and pile all frames up on it")
      ->needs(roi);
  app->add_option_function<std::string>(
         "--frames", [arguments](const std::string& text) { SetFrames(text, arguments); },
         "first:end, counted from 0, end not included. Default: all up to the first cut or gap")
      ->type_name("A:B");
  app->add_option("--reference", arguments->reference,
                  "Index of the frame whose pixels the scene is related to. Default: the last one; with --track, the "
                  "frame in which the target was picked, by default the first one")
      ->check(CLI::Range(0, kNumberMax))
      ->type_name("N");
  app->add_option("--set", arguments->overrides, "Change a field of the spec, for example tre.ratio=2; may be repeated")
      ->type_name("FIELD=VALUE")
      ->allow_extra_args(false);
  app->add_option("--threads", arguments->threads, "Threads that enhance; 0: one for each core. The result is the same for any number")
      ->capture_default_str()
      ->check(CLI::Range(0, 1024))
      ->type_name("N");
  app->add_option("--resolution-frames", arguments->resolution_frames,
                  "How resolution grows with the frames is measured with up to so many; 0: not at all")
      ->capture_default_str()
      ->check(CLI::Range(0, kFramesMax))
      ->type_name("N");
  app->add_flag("--json", arguments->json, "Print one JSON object on stdout at the end");
  app->add_flag("-q,--quiet", arguments->quiet, "No progress and no summary; warnings and errors stay");
  app->footer(kExamples);
}

}  // namespace

int RunEnhanceCommand(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Enhances the resolution of one ROI from many frames: fixed in the sensor, or following a target (--track).",
               "trem enhance");
  Declare(&app, &arguments);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  const StopOnSignal stop_on_signal;
  const Result<Outcome> outcome = Enhance(arguments);
  if (!outcome.ok()) {
    if (stop_requested) {
      fmt::print(stderr, "trem enhance: interrupted; nothing was written\n");
      return kExitInterrupted;
    }
    fmt::print(stderr, "trem enhance: {}\n", outcome.status().message());
    return ExitCodeOf(outcome.status());
  }
  for (const std::string& note : outcome->summary.notes) fmt::print(stderr, "note: {}\n", note);
  if (arguments.json) {
    PrintJson(*outcome);
  } else if (!arguments.quiet) {
    PrintSummary(*outcome);
  }
  return 0;
}

}  // namespace trem
