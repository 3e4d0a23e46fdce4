#pragma once

#include <string>

#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "mosaic/publish/report.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What the item tells besides the files themselves.
struct StacSource {
  const v1::SortieManifest& manifest;
  const v1::Alignment& alignment;
  const MosaicGrid& grid;
  const MosaicGrid sensor_grid;  // Of mosaic_baseline.tif.
  const ReportData& report;
  std::string mosaic_type;  // Data type of mosaic.tif, as the raster extension calls it.
};

// mosaic.stac.json for the outputs of `result`. The report gets no checksum: who fetches it may add the job's times to it.
Result<std::string> MakeStacItem(const StacSource& source, const v1::TaskResult& result);

}  // namespace trem
