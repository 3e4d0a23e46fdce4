#pragma once

#include "mosaic/base/status.h"
#include "worker/sortie/grey_image.h"

struct AVFrame;

namespace trem {

// Grey intensities of a decoded video frame, not rounded: the luma of YUV formats (limited range 16..235 is stretched to 0..255 and
// clamped), Rec. 601 luminance of RGB formats. More than 8 bits become 0..65535. kInvalidInput for pixel formats without either.
Result<GreyImage> GreyFromVideoFrame(const AVFrame& frame);

}  // namespace trem
