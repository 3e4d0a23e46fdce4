#pragma once

#include <filesystem>
#include <string>

namespace trem {

// `trem keys`: makes <folder>/<name>.key and <folder>/<name>.pub (an empty folder: here) and prints their paths. Returns the exit code.
int RunKeysCommand(const std::string& name, const std::string& role, const std::filesystem::path& folder);

}  // namespace trem
