#include "worker/tasks/baseline.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <set>

#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/vignetting.h"
#include "worker/tasks/target_frames.h"

namespace trem {
namespace {

constexpr int kStandingStep = 25;
constexpr double kMotionPart = 0.125;
// Fade-in of a frame from its border, sensor pixels.
constexpr double kTaperPx = 16.0;

Eigen::Vector2d CentreOf(const v1::SortieManifest& manifest) {
  return {0.5 * (manifest.width_px() - 1.0), 0.5 * (manifest.height_px() - 1.0)};
}

Roi ImageOf(const v1::SortieManifest& manifest) {
  const Roi valid = FromProto(manifest.valid_roi());
  const Roi whole{0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  const Roi image = Intersect(valid, whole);
  return image.empty() ? whole : image;
}

}  // namespace

Result<std::vector<FramePlacement>> AlignedPlacements(const v1::Alignment& alignment) {
  std::map<int, FramePlacement> frames;
  for (const v1::AlignedFrame& frame : alignment.frames()) {
    FramePlacement placement;
    placement.index = static_cast<int>(frame.frame_index());
    TREM_ASSIGN_OR_RETURN(placement.world_from_sensor, HomographyFromProto(frame.world_from_sensor(), "AlignedFrame.world_from_sensor"));
    placement.gain = frame.gain() > 0.0 ? frame.gain() : 1.0;
    placement.offset = frame.offset();
    frames.emplace(placement.index, placement);
  }
  std::vector<FramePlacement> placements;
  for (const auto& [index, placement] : frames) placements.push_back(placement);
  return placements;
}

Result<std::vector<FramePlacement>> ChainPlacements(const v1::SortieManifest& manifest, const v1::Alignment& alignment) {
  TREM_ASSIGN_OR_RETURN(const std::vector<FramePlacement> aligned, AlignedPlacements(alignment));
  std::map<int, FramePlacement> anchors;
  for (const FramePlacement& placement : aligned) anchors.emplace(placement.index, placement);
  const Eigen::Vector2d centre = CentreOf(manifest);
  std::vector<FramePlacement> chain;
  std::optional<Homography> world_from_previous;
  for (int i = 0; i < manifest.frames_size(); ++i) {
    const v1::ManifestFrame& record = manifest.frames(i);
    if (record.state() != v1::FRAME_USABLE) continue;
    TREM_ASSIGN_OR_RETURN(const std::optional<Affine> motion, BelievedMotion(record));
    const auto anchor = anchors.find(i);
    FramePlacement placement;
    placement.index = i;
    if (anchor != anchors.end()) placement = anchor->second;
    if (motion && world_from_previous) {
      placement.world_from_sensor = *world_from_previous * Homography::FromAffine(*motion);
    } else if (anchor != anchors.end() && placement.world_from_sensor.Depth(centre) != 0.0) {
      placement.world_from_sensor = Homography::FromAffine(placement.world_from_sensor.LinearisedAt(centre));
    } else {
      world_from_previous.reset();
      continue;
    }
    world_from_previous = placement.world_from_sensor;
    chain.push_back(placement);
  }
  return chain;
}

std::vector<FramePlacement> ThinnedOut(const std::vector<FramePlacement>& frames, const v1::SortieManifest& manifest) {
  const Eigen::Vector2d centre = CentreOf(manifest);
  const double step_px = kMotionPart * std::min(manifest.width_px(), manifest.height_px());
  std::vector<FramePlacement> kept;
  for (const FramePlacement& frame : frames) {
    if (!kept.empty()) {
      const Eigen::Vector2d moved = kept.back().world_from_sensor.Inverse() * (frame.world_from_sensor * centre) - centre;
      if (moved.norm() < step_px && frame.index - kept.back().index < kStandingStep) continue;
    }
    kept.push_back(frame);
  }
  return kept;
}

MosaicGrid SensorGrid(const MosaicGrid& grid, int ratio) {
  MosaicGrid coarse = grid;
  coarse.gsd = grid.gsd * ratio;
  coarse.origin_x = grid.origin_x + 0.5 * (coarse.gsd - grid.gsd);
  coarse.origin_y = grid.origin_y - 0.5 * (coarse.gsd - grid.gsd);
  coarse.width = (grid.width + ratio - 1) / ratio;
  coarse.height = (grid.height + ratio - 1) / ratio;
  return coarse;
}

FrameMosaic::FrameMosaic(const v1::SortieManifest& manifest, const ArtefactStore& store, std::vector<FramePlacement> frames)
    : manifest_(manifest), store_(store), frames_(std::move(frames)), files_(frames_.size()) {
  const double grey_offset = manifest.grey_offset(), grey_scale = manifest.grey_scale();
  for (const FramePlacement& frame : frames_) {
    CompositeScene scene;
    scene.window_id = static_cast<std::uint32_t>(frame.index);
    scene.world_from_scene = frame.world_from_sensor;
    scene.raster_in_scene = ImageOf(manifest);
    scene.gain = 1.0 / frame.gain;
    scene.offset = grey_offset * (1.0 - scene.gain) - grey_scale * frame.offset * scene.gain;
    scenes_.push_back(scene);
  }
}

FrameMosaic::~FrameMosaic() {
  std::error_code ignored;
  for (const std::filesystem::path& file : files_) {
    if (!file.empty()) std::filesystem::remove(file, ignored);
  }
}

Status FrameMosaic::Read(const MosaicGrid& grid, const std::vector<Roi>& rois_in_mosaic, const std::function<bool(double)>& progress) {
  std::set<std::size_t> wanted;
  for (const Roi& roi : rois_in_mosaic) {
    TREM_ASSIGN_OR_RETURN(const std::vector<std::size_t> reaching, ContributingScenes(grid, roi, scenes_));
    wanted.insert(reaching.begin(), reaching.end());
  }
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest_));
  const Roi image = ImageOf(manifest_);
  const Image<float> brightening =
      BrighteningOf(manifest_.sensor(), static_cast<int>(manifest_.width_px()), static_cast<int>(manifest_.height_px()));
  double done = 0.0;
  for (const std::size_t i : wanted) {
    if (!progress(done++ / static_cast<double>(wanted.size()))) return Cancelled("the reading of frames was stopped");
    if (!files_[i].empty()) continue;
    TREM_ASSIGN_OR_RETURN(Image<float> whole, reader->Read(frames_[i].index));
    Brighten(brightening, &whole);
    Image<float> pixels(image.width(), image.height());
    for (int y = image.y0; y < image.y1; ++y) std::copy_n(whole.row(y) + image.x0, image.width(), pixels.row(y - image.y0));
    files_[i] = store_.NewTemporaryPath(".tif");
    TREM_RETURN_IF_ERROR(WriteSceneRaster(files_[i], pixels, Image<float>(image.width(), image.height(), 1.0f)));
  }
  return {};
}

Result<CompositeTile> FrameMosaic::Compose(const MosaicGrid& grid, const Roi& roi_in_mosaic,
                                           const std::function<bool(double)>& progress) const {
  std::vector<CompositeScene> scenes;
  std::vector<const std::filesystem::path*> files;
  for (std::size_t i = 0; i < scenes_.size(); ++i) {
    if (files_[i].empty()) continue;
    scenes.push_back(scenes_[i]);
    files.push_back(&files_[i]);
  }
  CompositeOptions options;
  options.taper_cells = kTaperPx;
  const Roi image = ImageOf(manifest_);
  const SceneReader reader = [&](std::size_t index, const Roi& cells) { return ReadSceneRaster(*files[index], image.area(), cells); };
  return ComposeTile(grid, roi_in_mosaic, scenes, reader, options, progress);
}

}  // namespace trem
