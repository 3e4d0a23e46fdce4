#include "mosaic/raster/cog.h"

#include <cpl_string.h>

#include <system_error>

#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/georeference.h"

namespace trem {
namespace {

// Part of the work that writing the temporary file is.
constexpr double kTilesFraction = 0.5;

// Removes a file that a failed or finished step leaves behind.
class Remover {
 public:
  explicit Remover(std::filesystem::path path) : path_(std::move(path)) {}
  ~Remover() {
    std::error_code ignored;
    if (armed_) std::filesystem::remove(path_, ignored);
  }
  Remover(const Remover&) = delete;
  Remover& operator=(const Remover&) = delete;
  void Disarm() { armed_ = false; }

 private:
  std::filesystem::path path_;
  bool armed_ = true;
};

const char* Predictor(const CogSpec& spec) { return spec.type == CogSpec::Type::kFloat32 ? "3" : "2"; }

GDALDataType TypeOf(const CogSpec& spec) {
  switch (spec.type) {
    case CogSpec::Type::kInt32:
      return GDT_Int32;
    case CogSpec::Type::kUint8:
      return GDT_Byte;
    case CogSpec::Type::kUint16:
      return GDT_UInt16;
    default:
      return GDT_Float32;
  }
}

Result<GdalDatasetPtr> CreateTemporary(const std::filesystem::path& path, const CogSpec& spec, const GdalErrors& errors) {
  CPLStringList options;
  for (const char* option : {"TILED=YES", "BLOCKXSIZE=256", "BLOCKYSIZE=256", "COMPRESS=DEFLATE", "ZLEVEL=1", "INTERLEAVE=PIXEL",
                             "BIGTIFF=IF_SAFER", "SPARSE_OK=TRUE"}) {
    options.AddString(option);
  }
  options.SetNameValue("PREDICTOR", Predictor(spec));
  options.SetNameValue("NUM_THREADS", std::to_string(spec.threads).c_str());
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  TREM_CHECK(driver != nullptr);
  GdalDatasetPtr dataset(
      driver->Create(path.c_str(), spec.grid.width, spec.grid.height, static_cast<int>(spec.bands.size()), TypeOf(spec), options.List()));
  if (!dataset) return errors.WriteStatus("cannot create", path);
  TREM_RETURN_IF_ERROR(SetGeoreference(spec.grid, dataset.get()));
  for (const auto& [key, value] : spec.metadata) dataset->SetMetadataItem(key.c_str(), value.c_str());
  for (std::size_t i = 0; i < spec.bands.size(); ++i) {
    GDALRasterBand* band = dataset->GetRasterBand(static_cast<int>(i) + 1);
    band->SetDescription(spec.bands[i].c_str());
    if (spec.nodata) band->SetNoDataValue(*spec.nodata);
  }
  return dataset;
}

Status WriteTile(const MosaicGrid& grid, int index, std::vector<Image<float>> planes, GDALDataset* dataset) {
  const Roi roi = grid.TileRoi(index);
  TREM_CHECK(planes.size() == static_cast<std::size_t>(dataset->GetRasterCount()));
  for (std::size_t i = 0; i < planes.size(); ++i) {
    TREM_CHECK(planes[i].width() == roi.width() && planes[i].height() == roi.height());
    if (dataset->GetRasterBand(static_cast<int>(i) + 1)
            ->RasterIO(GF_Write, roi.x0, roi.y0, roi.width(), roi.height(), planes[i].pixels().data(), roi.width(), roi.height(),
                       GDT_Float32, 0, 0, nullptr) != CE_None) {
      return Failed("tile " + std::to_string(index) + " was not written");
    }
  }
  return {};
}

Status WriteTiles(const std::filesystem::path& path, const CogSpec& spec, const CogTileReader& reader,
                  const std::function<bool(double)>& progress) {
  GdalErrors errors;
  TREM_ASSIGN_OR_RETURN(GdalDatasetPtr dataset, CreateTemporary(path, spec, errors));
  const int tile_count = spec.grid.tile_count();
  for (int index = 0; index < tile_count; ++index) {
    if (!progress(kTilesFraction * index / tile_count)) return Cancelled("writing " + path.string() + " was stopped");
    TREM_ASSIGN_OR_RETURN(std::vector<Image<float>> planes, reader(index));
    if (!WriteTile(spec.grid, index, std::move(planes), dataset.get()).ok()) return errors.WriteStatus("cannot write", path);
  }
  dataset.reset();  // Writes what is still cached.
  if (errors.failed()) return errors.WriteStatus("cannot write", path);
  return {};
}

struct ProgressState {
  const std::function<bool(double)>* progress = nullptr;
  bool cancelled = false;
};

int ReportProgress(double fraction, const char*, void* data) {
  auto* state = static_cast<ProgressState*>(data);
  if (!(*state->progress)(kTilesFraction + (1.0 - kTilesFraction) * fraction)) state->cancelled = true;
  return state->cancelled ? FALSE : TRUE;
}

Status CopyToCog(const std::filesystem::path& tiles, const std::filesystem::path& path, const CogSpec& spec,
                 const std::function<bool(double)>& progress) {
  GdalErrors errors;
  TREM_ASSIGN_OR_RETURN(const GdalDatasetPtr source, OpenTiff(tiles, "temporary raster"));
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("COG");
  if (driver == nullptr) return Failed("this GDAL has no COG driver; version 3.1 or newer is needed");
  CPLStringList options;
  for (const char* option : {"BLOCKSIZE=512", "BIGTIFF=IF_SAFER", "OVERVIEWS=IGNORE_EXISTING"}) {
    options.AddString(option);
  }
  options.SetNameValue("NUM_THREADS", std::to_string(spec.threads).c_str());
  const bool zstd = spec.compression == CogSpec::Compression::kZstd;
  options.SetNameValue("COMPRESS", zstd ? "ZSTD" : "DEFLATE");
  options.SetNameValue("OVERVIEW_COMPRESS", zstd ? "ZSTD" : "DEFLATE");
  options.SetNameValue("LEVEL", zstd ? "9" : "6");
  options.SetNameValue("PREDICTOR", Predictor(spec));
  options.SetNameValue("OVERVIEW_PREDICTOR", Predictor(spec));
  options.SetNameValue("OVERVIEW_RESAMPLING", spec.overviews == CogSpec::Overviews::kAverage ? "AVERAGE" : "NEAREST");
  ProgressState state{&progress, false};
  GdalDatasetPtr copy(driver->CreateCopy(path.c_str(), source.get(), FALSE, options.List(), &ReportProgress, &state));
  const bool created = copy != nullptr;
  copy.reset();
  if (state.cancelled) return Cancelled("writing " + path.string() + " was stopped");
  if (!created || errors.failed()) return errors.WriteStatus("cannot write", path);
  return {};
}

}  // namespace

Status WriteCog(const std::filesystem::path& path, const CogSpec& spec, const CogTileReader& reader,
                const std::function<bool(double)>& progress) {
  TREM_CHECK(!spec.bands.empty() && spec.grid.width > 0 && spec.grid.height > 0);
  InitialiseGdal();
  const std::filesystem::path tiles = path.string() + ".tiles.tif";
  const Remover tiles_remover(tiles);
  TREM_RETURN_IF_ERROR(WriteTiles(tiles, spec, reader, progress));
  Remover path_remover(path);
  TREM_RETURN_IF_ERROR(CopyToCog(tiles, path, spec, progress));
  path_remover.Disarm();
  return {};
}

}  // namespace trem
