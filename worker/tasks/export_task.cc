// EXPORT: alignment, manifest, windows and tiles -> the files that a user gets.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <mutex>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/parallel.h"
#include "mosaic/base/version.h"
#include "mosaic/publish/detail_finder.h"
#include "mosaic/publish/picture.h"
#include "mosaic/publish/report.h"
#include "mosaic/raster/cog.h"
#include "mosaic/raster/georeference.h"
#include "proto/codec/convert.h"
#include "worker/tasks/baseline.h"
#include "worker/tasks/export_frames.h"
#include "worker/tasks/export_report.h"
#include "worker/tasks/export_stac.h"
#include "worker/tasks/task.h"
#include "worker/tasks/task_inputs.h"
#include "worker/tasks/tile_raster.h"

namespace trem {
namespace {

constexpr int kPreviewSideMax = 2048;
constexpr int kReportPreviewSideMax = 1200;
constexpr int kReportPictureSideMax = 640;
constexpr int kCropsMax = 3;
// Side of the report's enlarged crops, sensor pixels.
constexpr int kCropSidePx = 40;
constexpr std::uint32_t kDefaultRatio = 3;

// Pictures and figures that are gathered while the tiles stream by.
struct Pictures {
  Pictures(const MosaicGrid& grid, int crop_side)
      : detail(crop_side),
        preview(grid.width, grid.height, kPreviewSideMax),
        report_preview(grid.width, grid.height, kReportPreviewSideMax),
        count(grid.width, grid.height, kReportPictureSideMax),
        nmad(grid.width, grid.height, kReportPictureSideMax),
        sigma(grid.width, grid.height, kReportPictureSideMax) {}
  DetailFinder detail;
  Reduction preview, report_preview, count, nmad, sigma;
  long long covered = 0;
};

std::string EstimatorText(v1::MosaicEstimator estimator) {
  switch (estimator) {
    case v1::MEDIAN:
      return "median of the scenes";
    case v1::BIWEIGHT:
      return "biweight of the scenes";
    default:
      return "weighted median of the scenes";
  }
}

class Exporter {
 public:
  Exporter(const v1::TaskSpec& spec, const TaskContext& context) : spec_(spec), context_(context), store_(*context.store) {}
  Result<v1::TaskResult> Run();

 private:
  Status ReadInputs();
  Status PlaceTiles();
  Status WriteFrames();
  // The rasters, each of which is on its own: at once where threads may be used.
  Status WriteRasters();
  Status WriteMosaic(const std::filesystem::path& path);
  Status WriteQuality(const std::filesystem::path& path);
  Status WriteSource(const std::filesystem::path& path);
  // The pictures, and beside them what the report compares.
  Status WritePictures();
  Status WriteReport();
  Status WriteStacItem();
  // What the report compares with, and mosaic_baseline.tif when it is asked for. Fills nothing but its own.
  struct Comparison {
    std::vector<ReportCrop> crops;
    std::string left_out;            // Why there are no crops.
    std::filesystem::path baseline;  // Empty: not asked for, or left out.
  };
  Result<Comparison> Compare() const;
  Result<Image<float>> ReadMosaic(const Roi& roi) const;
  Status PutFile(const std::string& name, const std::filesystem::path& temporary);
  void AddNote(const std::string& code, const std::string& message, bool hole);
  Status PutBytes(const std::string& name, const std::string& bytes);
  // Verified when it is read for the first time.
  Result<std::vector<Image<float>>> ReadTile(int index, const std::vector<TilePlane>& planes) const;
  // Metadata of every raster.
  std::map<std::string, std::string> Metadata() const;
  CogSpec Spec() const;
  int ratio() const { return static_cast<int>(spec_.sortie().tre().ratio() > 0 ? spec_.sortie().tre().ratio() : kDefaultRatio); }
  // The integer type of mosaic.tif when it is to be the source's; kFloat32 otherwise.
  CogSpec::Type MosaicType() const;
  // Progress of a step that takes the task from `begin` to `end`.
  std::function<bool(double)> Step(double begin, double end) const {
    return [this, begin, end](double fraction) { return context_.progress(begin + (end - begin) * fraction); };
  }

  const v1::TaskSpec& spec_;
  const TaskContext& context_;
  const ArtefactStore& store_;
  v1::SortieManifest manifest_;
  v1::Alignment alignment_;
  MosaicGrid grid_;
  std::vector<std::optional<ArtefactRef>> tiles_;  // By tile index.
  mutable std::mutex store_mutex_;                 // What the store has to fetch comes one after the other.
  mutable std::vector<bool> is_verified_;          // By tile index.
  ReportData report_;
  std::optional<Pictures> pictures_;
  v1::TaskResult result_;
};

Status Exporter::ReadInputs() {
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef alignment, SingleInput(spec_, "alignment.pb"));
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(store_, alignment, &alignment_));
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef manifest, SingleInput(spec_, "manifest.pb"));
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(store_, manifest, &manifest_));
  TREM_ASSIGN_OR_RETURN(grid_, FromProto(alignment_.grid()));
  TREM_RETURN_IF_ERROR(PlaceTiles());
  if (!std::isfinite(manifest_.grey_offset()) || !(manifest_.grey_scale() > 0.0) || !std::isfinite(manifest_.grey_scale())) {
    return Corrupt("manifest.pb has grey_offset " + std::to_string(manifest_.grey_offset()) + " and grey_scale " +
                   std::to_string(manifest_.grey_scale()) + "; expected finite numbers and a positive scale");
  }
  return {};
}

// The inputs are the tiles that there are, in order; between them are those that could not be composed.
Status Exporter::PlaceTiles() {
  const std::vector<v1::ArtefactRef> present = InputsNamed(spec_, "tile.tif");
  const auto& missing = spec_.export_params().missing_tiles();
  const auto tile_count = static_cast<std::size_t>(grid_.tile_count());
  if (present.size() + static_cast<std::size_t>(missing.size()) != tile_count) {
    return InvalidInput("EXPORT task " + spec_.key() + " has " + std::to_string(present.size()) + " inputs named tile.tif and " +
                        std::to_string(missing.size()) + " missing tiles; the mosaic has " + std::to_string(tile_count) + " tiles");
  }
  is_verified_.assign(tile_count, false);
  std::size_t next_present = 0;
  for (std::size_t i = 0; i < tile_count; ++i) {
    const bool is_missing = std::find(missing.begin(), missing.end(), i) != missing.end();
    if (!is_missing && next_present == present.size()) return InvalidInput("EXPORT task " + spec_.key() + " repeats a missing tile");
    tiles_.push_back(is_missing ? std::nullopt : std::optional(FromProto(present[next_present++])));
  }
  return {};
}

Status Exporter::PutFile(const std::string& name, const std::filesystem::path& temporary) {
  TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, store_.PutFile(name, temporary));
  *result_.add_outputs() = ToProto(ref);
  return {};
}

Status Exporter::PutBytes(const std::string& name, const std::string& bytes) {
  TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, store_.PutBytes(name, bytes));
  *result_.add_outputs() = ToProto(ref);
  return {};
}

Result<std::vector<Image<float>>> Exporter::ReadTile(int index, const std::vector<TilePlane>& planes) const {
  const std::optional<ArtefactRef>& ref = tiles_[static_cast<std::size_t>(index)];
  if (!ref) return EmptyTilePlanes(grid_, index, planes);
  std::unique_lock lock(store_mutex_);
  if (!is_verified_[static_cast<std::size_t>(index)]) TREM_RETURN_IF_ERROR(store_.Verify(*ref));
  is_verified_[static_cast<std::size_t>(index)] = true;
  TREM_ASSIGN_OR_RETURN(const std::filesystem::path path, store_.Locate(*ref));
  lock.unlock();
  return ReadTilePlanes(path, grid_, index, planes);
}

std::map<std::string, std::string> Exporter::Metadata() const {
  return {{"TREM_SOFTWARE", report_.software},
          {"TREM_SORTIE", report_.sortie},
          {"TREM_FRAMES_USED", fmt::format("{} of {}", report_.registered_count, report_.frame_count)},
          {"TREM_COORDINATES", report_.georeferenced ? report_.crs_name : "local coordinates: no telemetry (" + report_.crs_name + ")"},
          {"TREM_GAUGE", report_.gauge},
          {"TREM_PIECES", std::to_string(report_.piece_count)},
          {"TREM_TIE_RMS_PX", fmt::format("{:.4f}", report_.tie_rms_px)}};
}

CogSpec Exporter::Spec() const {
  CogSpec cog;
  cog.grid = grid_;
  cog.metadata = Metadata();
  cog.nodata = std::numeric_limits<double>::quiet_NaN();
  if (spec_.sortie().mosaic().compression() == v1::ZSTD) cog.compression = CogSpec::Compression::kZstd;
  return cog;
}

CogSpec::Type Exporter::MosaicType() const {
  if (spec_.sortie().mosaic().pixel_type() != v1::SOURCE_TYPE) return CogSpec::Type::kFloat32;
  if (manifest_.grey_max() == 255.0) return CogSpec::Type::kUint8;
  return manifest_.grey_max() == 65535.0 ? CogSpec::Type::kUint16 : CogSpec::Type::kFloat32;
}

Status Exporter::WriteFrames() {
  FrameLedger ledger(manifest_, alignment_);
  const std::filesystem::path csv = store_.NewTemporaryPath(".csv");
  TREM_RETURN_IF_ERROR(ledger.Gather(store_, InputsNamed(spec_, "window.pb"), csv, Step(0.0, 0.1)));
  TREM_RETURN_IF_ERROR(PutFile("mosaic_chain.csv", csv));
  ledger.Summarise(&report_);
  TREM_ASSIGN_OR_RETURN(const std::vector<SceneFootprint> footprints, ledger.Footprints());
  const std::filesystem::path geojson = store_.NewTemporaryPath(".geojson");
  TREM_RETURN_IF_ERROR(WriteWindowsGeoJson(geojson, footprints, grid_.crs_wkt, alignment_.georeferenced()));
  TREM_RETURN_IF_ERROR(FillReportMap(manifest_, alignment_, grid_, footprints, &report_));
  TREM_RETURN_IF_ERROR(FillReportCharts(manifest_, alignment_, grid_, ratio(), &report_));
  return PutFile("mosaic_windows.geojson", geojson);
}

// 0 is what nothing covers; what is covered is at least 1.
void RoundToInteger(float grey_max, Image<float>* plane) {
  for (float& value : plane->pixels()) value = std::isfinite(value) ? std::clamp(std::round(value), 1.0f, grey_max) : 0.0f;
}

Status Exporter::WriteMosaic(const std::filesystem::path& path) {
  CogSpec cog = Spec();
  cog.bands = {report_.estimator + " [grey levels of the source]"};
  cog.type = MosaicType();
  const bool integer = cog.type != CogSpec::Type::kFloat32;
  if (integer) cog.nodata = 0.0;
  const float scale = static_cast<float>(manifest_.grey_scale()), offset = static_cast<float>(manifest_.grey_offset());
  const CogTileReader reader = [&](int index) -> Result<std::vector<Image<float>>> {
    TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> planes, ReadTile(index, {TilePlane::kMedian}));
    for (float& value : planes[0].pixels()) value = offset + scale * value;
    pictures_->preview.Add(grid_.TileRoi(index), planes[0]);
    pictures_->report_preview.Add(grid_.TileRoi(index), planes[0]);
    pictures_->detail.Add(grid_.TileRoi(index), planes[0]);
    if (integer) RoundToInteger(static_cast<float>(manifest_.grey_max()), &planes[0]);
    return planes;
  };
  return WriteCog(path, cog, reader, Step(0.1, 0.35));
}

Status Exporter::WriteQuality(const std::filesystem::path& path) {
  CogSpec cog = Spec();
  cog.threads = std::min(context_.threads, ThreadsMax());  // Half of all that is written.
  cog.bands = {"count of scenes", "NMAD between scenes [grey levels of the source]",
               report_.georeferenced ? "standard error of position [m]" : "standard error of position [sensor px]"};
  const float scale = static_cast<float>(manifest_.grey_scale());
  const CogTileReader reader = [&](int index) -> Result<std::vector<Image<float>>> {
    TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> planes,
                          ReadTile(index, {TilePlane::kCount, TilePlane::kNmad, TilePlane::kPositionSigma}));
    for (float& value : planes[1].pixels()) value *= scale;
    const Roi roi = grid_.TileRoi(index);
    Image<float> covered = planes[0];  // NaN instead of 0, so that means are over covered ground.
    for (float& value : covered.pixels()) {
      if (value > 0.0f) {
        ++pictures_->covered;
      } else {
        value = std::numeric_limits<float>::quiet_NaN();
      }
    }
    pictures_->count.Add(roi, covered);
    pictures_->nmad.Add(roi, planes[1]);
    pictures_->sigma.Add(roi, planes[2]);
    return planes;
  };
  return WriteCog(path, cog, reader, Step(0.35, 0.6));
}

Status Exporter::WriteSource(const std::filesystem::path& path) {
  CogSpec cog = Spec();
  cog.type = CogSpec::Type::kInt32;
  cog.overviews = CogSpec::Overviews::kNearest;
  cog.bands = {"window id of the dominant scene"};
  cog.nodata = static_cast<double>(kNoSource);
  const CogTileReader reader = [&](int index) { return ReadTile(index, {TilePlane::kSource}); };
  return WriteCog(path, cog, reader, Step(0.6, 0.7));
}

Status Exporter::WriteRasters() {
  struct Raster {
    const char* name;
    Status (Exporter::*write)(const std::filesystem::path& path);
    std::filesystem::path path;
    Status status;
  };
  // The one that takes longest first.
  std::array<Raster, 3> rasters = {{{"mosaic_quality.tif", &Exporter::WriteQuality, {}, {}},
                                    {"mosaic.tif", &Exporter::WriteMosaic, {}, {}},
                                    {"mosaic_source.tif", &Exporter::WriteSource, {}, {}}}};
  for (Raster& raster : rasters) raster.path = store_.NewTemporaryPath(".tif");
  ForEachIndex(context_.threads, static_cast<int>(rasters.size()), [&](int index, int) {
    Raster& raster = rasters[static_cast<std::size_t>(index)];
    raster.status = (this->*raster.write)(raster.path);
  });
  for (const Raster& raster : rasters) TREM_RETURN_IF_ERROR(raster.status);
  std::swap(rasters[0], rasters[1]);  // Outputs are listed with the mosaic first.
  for (const Raster& raster : rasters) TREM_RETURN_IF_ERROR(PutFile(raster.name, raster.path));
  return {};
}

// The middle value of a picture; NaN when it is empty.
double MiddleValue(const Image<float>& picture) {
  for (const float value : picture.pixels()) {
    if (std::isfinite(value)) return QuantileRange(picture, 0.5, 0.5).low;
  }
  return std::numeric_limits<double>::quiet_NaN();
}

Status Exporter::WritePictures() {
  const Image<float> preview = pictures_->preview.Picture();
  const ValueRange stretch = QuantileRange(preview, 0.005, 0.995);
  const Image<float> count = pictures_->count.Picture(), nmad = pictures_->nmad.Picture(), sigma = pictures_->sigma.Picture();
  report_.coverage = static_cast<double>(pictures_->covered) / (static_cast<double>(grid_.width) * grid_.height);
  report_.median_scenes = pictures_->covered > 0 ? MiddleValue(count) : 0.0;
  report_.median_nmad = MiddleValue(nmad);
  report_.median_position_sigma = MiddleValue(sigma);
  report_.preview.range = stretch;
  report_.count.range = {0.0, QuantileRange(count, 0.0, 1.0).high};
  report_.nmad.range = {0.0, QuantileRange(nmad, 0.0, 0.98).high};
  report_.sigma.range = QuantileRange(sigma, 0.0, 0.98);
  report_.grey_range = stretch.high - stretch.low;
  Result<Comparison> comparison = Failed("");
  std::array<Result<std::string>, 5> pngs = {Failed(""), Failed(""), Failed(""), Failed(""), Failed("")};
  // The longest first.
  ForEachIndex(context_.threads, static_cast<int>(pngs.size()) + 1, [&](int index, int) {
    if (index == 0) comparison = Compare();
    if (index == 1) pngs[0] = GreyPng(preview, stretch);
    if (index == 2) pngs[1] = GreyPng(pictures_->report_preview.Picture(), stretch);
    if (index == 3) pngs[2] = ColourPng(count, report_.count.range);
    if (index == 4) pngs[3] = ColourPng(nmad, report_.nmad.range);
    if (index == 5) pngs[4] = ColourPng(sigma, report_.sigma.range);
  });
  for (const Result<std::string>& png : pngs) TREM_RETURN_IF_ERROR(png.status());
  TREM_RETURN_IF_ERROR(PutBytes("mosaic_preview.png", *pngs[0]));
  report_.preview.png = std::move(*pngs[1]);
  report_.count.png = std::move(*pngs[2]);
  report_.nmad.png = std::move(*pngs[3]);
  report_.sigma.png = std::move(*pngs[4]);
  if (pictures_->covered == 0) {
    AddNote("mosaic_empty", "no scene covers any pixel of the mosaic; see mosaic.gsd, mosaic.bounds and mosaic.cutline_path", true);
  }
  TREM_RETURN_IF_ERROR(comparison.status());
  if (!comparison->left_out.empty()) AddNote("comparison_left_out", "the report compares nothing: " + comparison->left_out, false);
  report_.crops = std::move(comparison->crops);
  report_.baseline_written = !comparison->baseline.empty();
  return report_.baseline_written ? PutFile("mosaic_baseline.tif", comparison->baseline) : Status();
}

Result<Image<float>> Exporter::ReadMosaic(const Roi& roi) const {
  Image<float> pixels(roi.width(), roi.height(), std::numeric_limits<float>::quiet_NaN());
  const auto scale = static_cast<float>(manifest_.grey_scale()), offset = static_cast<float>(manifest_.grey_offset());
  for (int index = 0; index < grid_.tile_count(); ++index) {
    const Roi tile = grid_.TileRoi(index), part = Intersect(tile, roi);
    if (part.empty()) continue;
    TREM_ASSIGN_OR_RETURN(const std::vector<Image<float>> planes, ReadTile(index, {TilePlane::kMedian}));
    for (int y = part.y0; y < part.y1; ++y) {
      for (int x = part.x0; x < part.x1; ++x) pixels.at(x - roi.x0, y - roi.y0) = offset + scale * planes[0].at(x - tile.x0, y - tile.y0);
    }
  }
  return pixels;
}

Result<Exporter::Comparison> Exporter::Compare() const {
  Comparison comparison;
  const MosaicGrid sensor_grid = SensorGrid(grid_, ratio());
  const std::vector<Roi> places = pictures_->detail.Best(kCropsMax);
  const bool whole = spec_.sortie().mosaic().baseline();
  if (places.empty() && !whole) return comparison;
  TREM_ASSIGN_OR_RETURN(const std::vector<FramePlacement> chain, ChainPlacements(manifest_, alignment_));
  FrameMosaic baseline(manifest_, store_, ThinnedOut(chain, manifest_));
  std::vector<Roi> wanted;
  if (whole) wanted.push_back({0, 0, sensor_grid.width, sensor_grid.height});
  for (const Roi& place : places) wanted.push_back(SensorRoi(grid_, place, sensor_grid));
  // The source may be gone or damaged by now: the mosaic does not depend on it any more.
  const Status read = baseline.Read(sensor_grid, wanted, Step(0.7, 0.8));
  if (read.code() == StatusCode::kCancelled || read.code() == StatusCode::kExhausted) return read;
  Result<std::vector<ReportCrop>> crops = read.ok() ? MakeCrops(
                                                          manifest_, alignment_, grid_, sensor_grid, places,
                                                          [this](const Roi& roi) { return ReadMosaic(roi); }, baseline, Step(0.8, 0.85))
                                                    : Result<std::vector<ReportCrop>>(read);
  if (!crops.ok()) {
    if (crops.status().code() == StatusCode::kCancelled) return crops.status();
    comparison.left_out = crops.status().message();
    return comparison;
  }
  comparison.crops = std::move(*crops);
  if (!whole) return comparison;
  CogSpec cog = Spec();
  cog.grid = sensor_grid;
  cog.bands = {"median of frames placed by image motion [grey levels of the source]"};
  const CogTileReader reader = [&](int index) -> Result<std::vector<Image<float>>> {
    TREM_ASSIGN_OR_RETURN(CompositeTile tile, baseline.Compose(sensor_grid, sensor_grid.TileRoi(index), [](double) { return true; }));
    std::vector<Image<float>> planes;
    planes.push_back(std::move(tile.median));
    return planes;
  };
  comparison.baseline = store_.NewTemporaryPath(".tif");
  TREM_RETURN_IF_ERROR(WriteCog(comparison.baseline, cog, reader, Step(0.85, 0.95)));
  return comparison;
}

void Exporter::AddNote(const std::string& code, const std::string& message, bool hole) {
  v1::Note* note = result_.add_notes();
  note->set_code(code);
  note->set_subject(report_.sortie);
  note->set_message(message);
  note->set_severity(v1::WARNING);
  note->set_hole(hole);
}

Status Exporter::WriteReport() {
  // Of every task of the job; what manifest and alignment say is among them.
  for (const auto* notes : {&spec_.export_params().holes(), &spec_.export_params().notes(), &result_.notes()}) {
    for (const v1::Note& note : *notes) {
      report_.notes.push_back({note.severity() == v1::WARNING, note.code(), note.subject(), note.message()});
      report_.hole_count += note.hole() ? 1 : 0;
    }
  }
  report_.hole_count += static_cast<std::uint32_t>(spec_.export_params().holes_size());
  TREM_ASSIGN_OR_RETURN(const std::string html, RenderReport(report_, context_.threads));
  return PutBytes("mosaic_report.html", html);
}

Status Exporter::WriteStacItem() {
  const std::string type = MosaicType() == CogSpec::Type::kFloat32 ? "float32" : MosaicType() == CogSpec::Type::kUint8 ? "uint8" : "uint16";
  StacSource source{manifest_, alignment_, grid_, SensorGrid(grid_, ratio()), report_, type};
  TREM_ASSIGN_OR_RETURN(const std::string json, MakeStacItem(source, result_));
  return PutBytes("mosaic.stac.json", json);
}

Result<v1::TaskResult> Exporter::Run() {
  TREM_RETURN_IF_ERROR(ReadInputs());
  report_.sortie =
      spec_.sortie().name().empty() ? std::filesystem::path(manifest_.source_path()).filename().string() : spec_.sortie().name();
  report_.source = manifest_.source_path();
  report_.software = std::string("trem ") + TREM_VERSION + ", engine " + kEngineRevision;
  report_.georeferenced = alignment_.georeferenced();
  report_.crs_name = CrsName(grid_.crs_wkt);
  report_.gauge = alignment_.gauge();
  report_.width = grid_.width;
  report_.height = grid_.height;
  report_.gsd = grid_.gsd;
  report_.piece_count = alignment_.piece_count();
  report_.tie_rms_px = alignment_.tie_rms_px();
  report_.estimator = EstimatorText(spec_.sortie().mosaic().estimator());
  pictures_.emplace(grid_, kCropSidePx * ratio());
  TREM_RETURN_IF_ERROR(WriteFrames());
  TREM_RETURN_IF_ERROR(WriteRasters());
  TREM_RETURN_IF_ERROR(WritePictures());
  TREM_RETURN_IF_ERROR(WriteReport());
  TREM_RETURN_IF_ERROR(WriteStacItem());
  if (!context_.progress(1.0)) return Cancelled("the export was stopped");
  return result_;
}

}  // namespace

Result<v1::TaskResult> RunExportTask(const v1::TaskSpec& spec, const TaskContext& context) {
  cv::setNumThreads(1);
  return Exporter(spec, context).Run();
}

}  // namespace trem
