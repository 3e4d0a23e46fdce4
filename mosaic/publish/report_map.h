#pragma once

#include <string>

#include "mosaic/publish/report.h"

namespace trem {

// The preview with footprints, track and a scale bar over it, as one inline SVG whose user unit is a mosaic pixel, with switches for the
// layers that need no script. Empty without a preview.
std::string MapSvg(const ReportData& data);

// The largest of 1, 2 and 5 times a power of ten that is at most `length`. Precondition: length > 0.
double RoundLength(double length);

}  // namespace trem
