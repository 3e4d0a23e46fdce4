#pragma once

#include <string>

#include "mosaic/raster/geotiff.h"
#include "worker/app/enhance_outputs.h"
#include "worker/app/published_scene.h"

namespace trem {

// STEM_report.html: the comparison, the scene with its standard deviation, information and residuals, figures, and charts of the chain.
// `scene` is what is written to STEM.tif, `comparison_png` the bytes of STEM_comparison.png.
Result<std::string> EnhanceReport(const EnhancedWindow& enhanced, const PublishedScene& published, const GreyScale& grey,
                                  const FloatRaster& scene, const std::string& comparison_png, const EnhanceSummary& summary);

}  // namespace trem
