#pragma once

#include "proto/trem/v1/task.pb.h"

namespace trem {

// Splits the frames of `manifest` (states, times and motions are set) into spans: runs of frames in which every usable frame was
// registered to the usable one before it and no gap in time is longer than 2 s and than 8 median frame intervals. Cuts, gaps, and usable
// frames that stand alone (and so belong to no span) are noted.
void SplitIntoSpans(v1::SortieManifest* manifest);

}  // namespace trem
