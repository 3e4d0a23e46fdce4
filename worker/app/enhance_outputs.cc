#include "worker/app/enhance_outputs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "mosaic/base/file.h"
#include "mosaic/publish/picture.h"
#include "mosaic/raster/geotiff.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/app/enhance_chain.h"
#include "worker/app/enhance_report.h"
#include "worker/app/published_scene.h"
#include "worker/sensor/bicubic.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/vignetting.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Picture columns between the two halves of the comparison.
constexpr int kGapPx = 6;
constexpr double kStretchTail = 0.003;
// Part of the reference frame's ROI that the scene should show; less is worth a note.
constexpr double kCoverMin = 0.5;

// "3-7, 9, 12-20".
std::string RangesOf(const v1::Segment& segment) {
  std::string text;
  for (int i = 0; i < segment.chain_size();) {
    int last = i;
    while (last + 1 < segment.chain_size() && segment.chain(last + 1).frame_index() == segment.chain(last).frame_index() + 1) ++last;
    text += (text.empty() ? "" : ", ") + std::to_string(segment.chain(i).frame_index());
    if (last > i) text += "-" + std::to_string(segment.chain(last).frame_index());
    i = last + 1;
  }
  return text;
}

Status NothingEnhanced(const v1::WindowResult& window) {
  std::string why = window.frames_size() > 0 ? window.frames(0).reason() : "";
  return Failed(fmt::format("none of the frames {}:{} could be used{}{}; choose others with --frames", window.frame_begin(),
                            window.frame_end(), why.empty() ? "" : ": the first one ", why));
}

Result<PublishedScene> Choose(const v1::WindowResult& window, std::optional<int> reference) {
  PublishedScene choice;
  for (const v1::Segment& segment : window.segments()) {
    if (segment.scenes_size() > 0 && segment.chain_size() > 0) choice.segment = &segment;
  }
  if (choice.segment == nullptr) return NothingEnhanced(window);
  choice.scene = &choice.segment->scenes(choice.segment->scenes_size() - 1);
  choice.reference = &choice.segment->chain(choice.segment->chain_size() - 1);
  if (reference.has_value()) {
    const auto& chain = choice.segment->chain();
    const auto found = std::find_if(chain.begin(), chain.end(), [&](const v1::ChainView& view) {
      return view.frame_index() == static_cast<std::uint32_t>(*reference);
    });
    if (found == chain.end()) {
      return InvalidInput(fmt::format("--reference {}: frame {} is not registered to the published scene; choose one of {}", *reference,
                                      *reference, RangesOf(*choice.segment)));
    }
    choice.reference = &*found;
  }
  TREM_ASSIGN_OR_RETURN(choice.pixel_from_sensor, PixelFromSensor(*choice.reference, *choice.scene));
  return choice;
}

FloatRaster SceneFile(const EnhancedWindow& enhanced, const PublishedScene& choice, const SceneRaster& scene, const GreyScale& grey) {
  FloatRaster raster;
  const auto seen = [&](const Image<float>& band, double offset) {
    Image<float> out(scene.information.width(), scene.information.height(), kNan);
    for (std::size_t i = 0; i < out.pixels().size(); ++i) {
      if (scene.information.pixels()[i] > 0.0F && !band.empty())
        out.pixels()[i] = static_cast<float>(offset + grey.scale * band.pixels()[i]);
    }
    return out;
  };
  raster.bands.push_back({"intensity", seen(scene.intensity, grey.offset)});
  raster.bands.push_back({"standard deviation", seen(scene.sigma, 0.0)});
  raster.bands.push_back({"information", scene.information});
  raster.bands.push_back({"residual", seen(scene.residual, 0.0)});
  raster.nodata = std::numeric_limits<double>::quiet_NaN();
  // A geotransform is affine; of a projective reference view it is the one that agrees at the ROI's centre.
  const Roi roi = FromProto(enhanced.window->roi_in_sensor());
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  raster.geotransform = GeoTransformFromAffine(choice.pixel_from_sensor.LinearisedAt(centre).Inverse());
  const std::uint32_t index = choice.reference->frame_index();
  raster.metadata["REFERENCE_FRAME"] = enhanced.manifest->frames(static_cast<int>(index)).name();
  raster.metadata["REFERENCE_FRAME_INDEX"] = std::to_string(index);
  raster.metadata["ROI"] = fmt::format("{},{},{},{}", roi.x0, roi.y0, roi.width(), roi.height());
  raster.metadata["FRAMES"] = fmt::format("{}:{}", enhanced.window->frame_begin(), enhanced.window->frame_end());
  return raster;
}

struct Comparison {
  Image<float> picture;  // Grey levels of the source; NaN between the halves and where the scene was never seen.
  double cover = 0.0;    // Part of the ROI that the scene shows.
};

Comparison Compare(const EnhancedWindow& enhanced, const PublishedScene& choice, const SceneRaster& scene, const GreyScale& grey,
                   const Image<float>& frame) {
  const Roi roi = FromProto(enhanced.window->roi_in_sensor());
  const int width = roi.width() * enhanced.ratio;
  const int height = roi.height() * enhanced.ratio;
  Comparison comparison{Image<float>(2 * width + kGapPx, height, kNan), 0.0};
  long long shown = 0;
  const double middle = 0.5 * (enhanced.ratio - 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector2d sensor(roi.x0 + (x - middle) / enhanced.ratio, roi.y0 + (y - middle) / enhanced.ratio);
      comparison.picture.at(x, y) =
          SampleCubic(frame, std::clamp(sensor.x(), 1.0, frame.width() - 2.001), std::clamp(sensor.y(), 1.0, frame.height() - 2.001));
      const float internal = SampleSeen(scene, choice.pixel_from_sensor * sensor);
      if (std::isnan(internal)) continue;
      comparison.picture.at(width + kGapPx + x, y) =
          static_cast<float>(grey.Source(choice.reference->gain() * internal + choice.reference->offset()));
      ++shown;
    }
  }
  comparison.cover = static_cast<double>(shown) / (static_cast<double>(width) * height);
  return comparison;
}

void CountOutcomes(const v1::WindowResult& window, EnhanceSummary* summary) {
  summary->frame_count = window.frames_size();
  summary->segment_count = window.segments_size();
  for (const v1::FrameOutcome& frame : window.frames()) {
    if (frame.outcome() == v1::SKIPPED) {
      ++summary->skipped_count;
    } else if (frame.outcome() == v1::LOST) {
      ++summary->lost_count;
    } else {
      ++summary->registered_count;
    }
  }
}

// "frames 30-39 lost: why" for the first runs of lost frames; frames of one run have the reason of its first.
void AddLostRuns(const v1::WindowResult& window, EnhanceSummary* summary) {
  constexpr int kRunsMax = 8;
  int runs = 0;
  for (int i = 0; i < window.frames_size(); ++i) {
    if (window.frames(i).outcome() != v1::LOST) continue;
    int last = i;
    while (last + 1 < window.frames_size() && window.frames(last + 1).outcome() == v1::LOST) ++last;
    const std::uint32_t from = window.frames(i).frame_index();
    const std::uint32_t to = window.frames(last).frame_index();
    if (++runs <= kRunsMax) {
      summary->notes.push_back((last > i ? fmt::format("frames {}-{} lost: ", from, to) : fmt::format("frame {} lost: ", from)) +
                               window.frames(i).reason());
    }
    i = last;
  }
  if (runs > kRunsMax) summary->notes.push_back(fmt::format("{} more runs of lost frames: see the chain", runs - kRunsMax));
}

void AddNotes(const EnhancedWindow& enhanced, const PublishedScene& choice, double cover, EnhanceSummary* summary) {
  AddLostRuns(*enhanced.window, summary);
  const int scene_count = choice.segment->scenes_size();
  if (enhanced.window->segments_size() > 1) {
    summary->notes.push_back(
        fmt::format("the frames fell into {} segments (a cut, a lost lock, or a view that turned too far); the scene is of "
                    "the last one, frames {}",
                    enhanced.window->segments_size(), RangesOf(*choice.segment)));
  }
  if (scene_count > 1) {
    summary->notes.push_back(
        fmt::format("the ROI moved on over the ground through {} scenes; this is the last one, where it was at frames "
                    "{} to {}",
                    scene_count, choice.scene->frame_begin(), choice.scene->frame_end() - 1));
  }
  if (cover < kCoverMin) {
    summary->notes.push_back(fmt::format("the scene shows {:.0f} % of the ROI of reference frame {}; a later frame shows more",
                                         100.0 * cover, choice.reference->frame_index()));
  }
}

}  // namespace

float SampleSeen(const SceneRaster& scene, const Eigen::Vector2d& pixel) {
  if (!CubicSupported(scene.intensity, pixel.x(), pixel.y())) return kNan;
  for (int j = -1; j <= 2; ++j) {
    for (int i = -1; i <= 2; ++i) {
      if (!(scene.information.at(static_cast<int>(pixel.x()) + i, static_cast<int>(pixel.y()) + j) > 0.0F)) return kNan;
    }
  }
  return SampleCubic(scene.intensity, pixel.x(), pixel.y());
}

Result<PlanarMap> PixelFromSensor(const v1::ChainView& view, const v1::EmittedScene& scene) {
  TREM_ASSIGN_OR_RETURN(const PlanarMap scene_from_sensor, PlanarMapFromProto(view.scene_from_sensor(), "scene_from_sensor"));
  Affine pixel_from_scene;
  pixel_from_scene.offset = -Eigen::Vector2d(scene.roi_in_scene().x0(), scene.roi_in_scene().y0());
  return PlanarMap(pixel_from_scene) * scene_from_sensor;
}

std::vector<fs::path> EnhanceOutputPaths(const fs::path& scene_path) {
  const fs::path folder = scene_path.parent_path();
  const std::string stem = scene_path.stem().string();
  return {scene_path, folder / (stem + "_chain.csv"), folder / (stem + "_comparison.png"), folder / (stem + "_report.html")};
}

Result<EnhanceSummary> PublishEnhancedScene(const EnhancedWindow& enhanced, std::optional<int> reference, const fs::path& scene_path,
                                            int resolution_frames, const EnhanceFrames& enhance) {
  TREM_ASSIGN_OR_RETURN(const PublishedScene choice, Choose(*enhanced.window, reference));
  TREM_ASSIGN_OR_RETURN(const fs::path stored, enhanced.store->Locate(FromProto(choice.scene->raster())));
  TREM_ASSIGN_OR_RETURN(const SceneRaster scene, ReadSceneRaster(stored, kScenePixelsMax));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(*enhanced.manifest));
  const int index = static_cast<int>(choice.reference->frame_index());
  TREM_ASSIGN_OR_RETURN(Image<float> frame, reader->Read(index));
  Brighten(BrighteningOf(enhanced.manifest->sensor(), frame.width(), frame.height()), &frame);

  const GreyScale grey{enhanced.manifest->grey_offset(), enhanced.manifest->grey_scale()};
  const Comparison comparison = Compare(enhanced, choice, scene, grey, frame);
  TREM_ASSIGN_OR_RETURN(const std::string png,
                        GreyPng(comparison.picture, QuantileRange(comparison.picture, kStretchTail, 1.0 - kStretchTail)));
  TREM_ASSIGN_OR_RETURN(const std::string csv, EnhanceChainCsv(enhanced, choice, grey));
  const FloatRaster file = SceneFile(enhanced, choice, scene, grey);
  const fs::path temporary = enhanced.store->NewTemporaryPath(".tif");
  TREM_RETURN_IF_ERROR(WriteFloatRaster(temporary, file));

  EnhanceSummary summary;
  summary.reference_index = index;
  summary.reference_name = enhanced.manifest->frames(index).name();
  summary.noise_sigma = grey.scale * enhanced.window->noise_sigma();
  summary.outputs = EnhanceOutputPaths(scene_path);
  CountOutcomes(*enhanced.window, &summary);
  AddNotes(enhanced, choice, comparison.cover, &summary);
  TREM_ASSIGN_OR_RETURN(summary.resolution, ResolutionByFrames(enhanced, choice, resolution_frames, enhance));
  TREM_ASSIGN_OR_RETURN(const std::string report, EnhanceReport(enhanced, choice, grey, file, png, summary));
  TREM_RETURN_IF_ERROR(WriteFileAtomically(summary.outputs[1], csv));
  TREM_RETURN_IF_ERROR(WriteFileAtomically(summary.outputs[2], png));
  TREM_RETURN_IF_ERROR(WriteFileAtomically(summary.outputs[3], report));
  TREM_RETURN_IF_ERROR(PublishFile(temporary, summary.outputs[0]));
  return summary;
}

}  // namespace trem
