#pragma once

#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// The one input artefact called `name`; kInvalidInput that names the task when there is none, or more than one.
Result<v1::ArtefactRef> SingleInput(const v1::TaskSpec& spec, const std::string& name);

// All input artefacts called `name`, in the spec's order.
std::vector<v1::ArtefactRef> InputsNamed(const v1::TaskSpec& spec, const std::string& name);

}  // namespace trem
