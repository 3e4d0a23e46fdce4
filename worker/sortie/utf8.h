#pragma once

#include <string>
#include <string_view>

namespace trem {

// Protobuf texts must be UTF-8; file names and the contents of files need not be.
bool IsValidUtf8(std::string_view text);

// `text`, with every byte beyond ASCII replaced by '?' when it is not valid UTF-8.
std::string ToValidUtf8(std::string text);

}  // namespace trem
