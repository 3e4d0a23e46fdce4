#pragma once

#include <google/protobuf/descriptor.h>

#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// Checks JSON `text` against message type `type` before it is converted: syntax, unknown and repeated fields, types, enumerations.
// Errors are kInvalidInput and start with "<file_name>:<line>:<column>: ". Field names as in the .proto file or in lowerCamelCase;
// null stands for the default. Types without repeated fields only.
Status CheckSpecJson(std::string_view text, const std::string& file_name, const google::protobuf::Descriptor& type);

}  // namespace trem
