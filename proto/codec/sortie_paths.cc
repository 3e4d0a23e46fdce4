#include "proto/codec/sortie_paths.h"

namespace trem {

std::vector<SortiePath> PathsOf(v1::Sortie* sortie) {
  std::vector<SortiePath> paths;
  // Of a message that is not there nothing is made: the spec's bytes stay as they are.
  const auto add = [&](const char* field, const std::string& value, auto mutable_value) {
    if (!value.empty()) paths.push_back({field, mutable_value()});
  };
  add("source.path", sortie->source().path(), [&] { return sortie->mutable_source()->mutable_path(); });
  add("telemetry.path", sortie->telemetry().path(), [&] { return sortie->mutable_telemetry()->mutable_path(); });
  add("telemetry.dem_path", sortie->telemetry().dem_path(), [&] { return sortie->mutable_telemetry()->mutable_dem_path(); });
  add("sensor.psf_kernel_path", sortie->sensor().psf_kernel_path(), [&] { return sortie->mutable_sensor()->mutable_psf_kernel_path(); });
  add("sensor.bad_pixel_path", sortie->sensor().bad_pixel_path(), [&] { return sortie->mutable_sensor()->mutable_bad_pixel_path(); });
  add("sensor.mask_path", sortie->sensor().mask_path(), [&] { return sortie->mutable_sensor()->mutable_mask_path(); });
  add("control.path", sortie->control().path(), [&] { return sortie->mutable_control()->mutable_path(); });
  add("mosaic.cutline_path", sortie->mosaic().cutline_path(), [&] { return sortie->mutable_mosaic()->mutable_cutline_path(); });
  for (v1::Recording& recording : *sortie->mutable_more()) {
    add("more.source.path", recording.source().path(), [&] { return recording.mutable_source()->mutable_path(); });
    add("more.telemetry.path", recording.telemetry().path(), [&] { return recording.mutable_telemetry()->mutable_path(); });
    add("more.telemetry.dem_path", recording.telemetry().dem_path(), [&] { return recording.mutable_telemetry()->mutable_dem_path(); });
  }
  return paths;
}

}  // namespace trem
