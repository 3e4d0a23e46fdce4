#pragma once

#include <stdlib.h>

#include <filesystem>
#include <string>
#include <system_error>

namespace trem {

// A folder among the temporary ones, for as long as this lives.
class ProbeFolder {
 public:
  ProbeFolder() : path_((std::filesystem::temp_directory_path() / "trem-XXXXXX").string()) {
    if (::mkdtemp(path_.data()) == nullptr) path_.clear();  // Writing into it then fails, and says so.
  }
  ~ProbeFolder() {
    std::error_code ignored;
    if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
  }
  ProbeFolder(const ProbeFolder&) = delete;
  ProbeFolder& operator=(const ProbeFolder&) = delete;
  std::filesystem::path operator/(const char* name) const { return std::filesystem::path(path_) / name; }

 private:
  std::string path_;
};

}  // namespace trem
