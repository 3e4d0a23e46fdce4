#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

#include "mosaic/base/check.h"

namespace trem::fuzz {

// A new folder for a target's files; it stays when the target ends.
inline std::filesystem::path MakeScratchFolder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "trem-fuzz-XXXXXX").string();
  TREM_CHECK(::mkdtemp(pattern.data()) != nullptr);
  return pattern;
}

}  // namespace trem::fuzz
