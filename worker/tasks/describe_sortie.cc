#include "worker/tasks/describe_sortie.h"

#include <fmt/format.h>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/polygons.h"
#include "worker/sensor/resolution.h"
#include "worker/sortie/frame_source.h"
#include "worker/sortie/ingest.h"
#include "worker/tasks/cutline_message.h"
#include "worker/tasks/estimate_sensor.h"
#include "worker/tasks/sensor_of.h"

namespace trem {
namespace {

// Part of the progress that reading the frames takes, about.
constexpr double kReadingPart = 0.9;

void AddKernel(const PsfKernel& kernel, const std::string& path, v1::SortieManifest* manifest) {
  v1::PsfKernelMessage* message = manifest->mutable_sensor()->mutable_psf_kernel();
  message->set_width(static_cast<std::uint32_t>(kernel.width));
  message->set_height(static_cast<std::uint32_t>(kernel.height));
  message->set_samples_per_pixel(kernel.samples_per_pixel);
  message->mutable_values()->Add(kernel.values.begin(), kernel.values.end());
  const KernelCentroid centroid = CentroidOf(kernel);
  *manifest->add_notes() = MakeNote(
      v1::INFO, "psf_kernel", path,
      fmt::format("point spread function of {} x {} samples, {:g} a sensor pixel; its centroid lies {:+.3f}, {:+.3f} px (right, down) from "
                  "the middle of the file and is taken out",
                  kernel.width, kernel.height, kernel.samples_per_pixel, centroid.x / kernel.samples_per_pixel,
                  centroid.y / kernel.samples_per_pixel));
}

void AddCeiling(const v1::Sortie& sortie, v1::SortieManifest* manifest) {
  v1::SensorManifest* sensor = manifest->mutable_sensor();
  const double q = OpticsQ(sortie.sensor());
  const ResolutionCeiling ceiling = FindResolutionCeiling(PsfParametersOf(sortie.sensor(), *sensor), q,
                                                          sortie.tre().ratio() > 0 ? static_cast<int>(sortie.tre().ratio()) : 3);
  sensor->set_optics_q(q);
  sensor->set_ceiling_cycles_per_px(ceiling.cycles_per_px);
  sensor->set_ceiling_limit(ceiling.limit);
  std::string text =
      fmt::format("the finest detail that can be resolved is {:.2f} cycles/px, {:.2f} times a single frame's Nyquist frequency: {}",
                  ceiling.cycles_per_px, 2.0 * ceiling.cycles_per_px, ceiling.limit);
  text += fmt::format(" (scene grid {:.2f}, detector {:.2f}", ceiling.grid_nyquist, ceiling.detector_zero);
  if (q > 0.0) text += fmt::format(", optics {:.2f} with Q {:.2f}", ceiling.optics_cutoff, q);
  *manifest->add_notes() = MakeNote(v1::INFO, "resolution_ceiling", sortie.source().path(), text + ")");
}

// What is wrong with the mosaic that is asked for is said before anything is computed.
Result<PolygonRings> CheckMosaic(const v1::Mosaic& mosaic) {
  if (!mosaic.crs().empty()) TREM_RETURN_IF_ERROR(UtmFrame::ForCrs(mosaic.crs()).status().WithPrefix("mosaic.crs"));
  PolygonRings cutline;
  if (!mosaic.cutline_path().empty()) {
    Result<PolygonRings> read = ReadPolygons(mosaic.cutline_path());
    if (!read.ok()) return read.status().WithPrefix("mosaic.cutline_path");
    cutline = std::move(*read);
  }
  return cutline;
}

}  // namespace

Result<v1::SortieManifest> DescribeSortie(const v1::Sortie& sortie, const std::function<bool(double fraction)>& progress, int threads) {
  PsfKernel kernel;
  const bool measured = sortie.sensor().psf_model() == v1::KERNEL_FILE;
  if (measured) {
    TREM_ASSIGN_OR_RETURN(kernel, ReadPsfKernel(sortie.sensor().psf_kernel_path()));
  }
  TREM_ASSIGN_OR_RETURN(const PolygonRings cutline, CheckMosaic(sortie.mosaic()));
  const auto part = [&progress](double from, double to) {
    return [&progress, from, to](double fraction) { return !progress || progress(from + (to - from) * fraction); };
  };
  TREM_ASSIGN_OR_RETURN(v1::SortieManifest manifest, IngestSortie(sortie, part(0.0, kReadingPart), threads));
  if (!cutline.rings.empty()) ToProto(cutline, manifest.mutable_cutline());
  if (measured) AddKernel(kernel, sortie.sensor().psf_kernel_path(), &manifest);
  TREM_RETURN_IF_ERROR(EstimateSensor(sortie, part(kReadingPart, 1.0), &manifest));
  AddCeiling(sortie, &manifest);
  if (progress && !progress(1.0)) return Cancelled(sortie.source().path() + ": ingest was stopped");
  return manifest;
}

}  // namespace trem
