#pragma once

#include <string>

#include "worker/app/enhance_outputs.h"
#include "worker/app/published_scene.h"

namespace trem {

// STEM_chain.csv: one row per frame and segment, in grey levels of the source and, for the published segment, in pixels of the published
// scene. Behind the registration come the ROI in that frame, the covariance of gain and offset, and that of the ROI's corners: the upper
// triangle, row by row, over (ul.x, ul.y, ur.x, ur.y, ll.x, ll.y) and, for projective views, (lr.x, lr.y) [sensor px^2]. Lines end in \n.
Result<std::string> EnhanceChainCsv(const EnhancedWindow& enhanced, const PublishedScene& published, const GreyScale& grey);

// Largest standard deviation of a corner coordinate [sensor px].
double CornerSigma(const v1::ChainView& view);

}  // namespace trem
