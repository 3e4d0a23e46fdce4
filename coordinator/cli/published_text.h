#pragma once

#include <filesystem>
#include <string>

#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// What only the one who fetches the results knows goes into two of them as they are published: the times of the job into the report
// (artefacts hold none, so that the same job has the same ones), and the names that the files got into the STAC item.
bool IsFinishedWhenPublished(const std::string& name);

// `text` of the result `name`, finished for a mosaic that is published at `output`. Other results come back as they are. kCorrupt when
// the STAC item is no JSON.
Result<std::string> FinishedText(const std::string& name, const std::string& text, const std::filesystem::path& output,
                                 const v1::JobStatus& job);

}  // namespace trem
