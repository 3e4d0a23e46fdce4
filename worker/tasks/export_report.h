#pragma once

#include <functional>
#include <string>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/publish/report.h"
#include "mosaic/publish/windows_geojson.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/tasks/baseline.h"

namespace trem {

// What the report draws over the preview and beside it, from what the job knows: footprints and track on the mosaic's pixels, where the
// mosaic's corners are, the charts over the frames.
Status FillReportMap(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid,
                     const std::vector<SceneFootprint>& footprints, ReportData* report);
Status FillReportCharts(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid, int ratio,
                        ReportData* report);

// Gives the mosaic's pixels of a rectangle, grey levels of the source.
using MosaicReader = std::function<Result<Image<float>>(const Roi& roi_in_mosaic)>;

// Crops of `rois_in_mosaic`: the mosaic, the frame that sees each best enlarged bicubically, and what `baseline` (which has read the frames
// that reach them on `sensor_grid`) makes of it. What no frame or no baseline covers is left out.
Result<std::vector<ReportCrop>> MakeCrops(const v1::SortieManifest& manifest, const v1::Alignment& alignment, const MosaicGrid& grid,
                                          const MosaicGrid& sensor_grid, const std::vector<Roi>& rois_in_mosaic, const MosaicReader& mosaic,
                                          const FrameMosaic& baseline, const std::function<bool(double)>& progress);

// Enlarges an image on `sensor_grid` bicubically onto the rectangle of `grid`; `roi_in_sensor_grid` is what `pixels` holds.
Image<float> EnlargedOnto(const MosaicGrid& grid, const Roi& roi_in_mosaic, const MosaicGrid& sensor_grid, const Roi& roi_in_sensor_grid,
                          const Image<float>& pixels);
// Pixels of `sensor_grid` under `roi_in_mosaic` of `grid` with the margin that EnlargedOnto needs.
Roi SensorRoi(const MosaicGrid& grid, const Roi& roi_in_mosaic, const MosaicGrid& sensor_grid);

}  // namespace trem
