#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace trem::layering {

struct Violation {
  std::string file;  // Relative to the root of the sources.
  int line = 0;      // Counted from 1; 0: the file as a whole.
  std::string what;
};

// "file:line: what", one a line.
std::string ToString(const std::vector<Violation>& violations);

// Most lines that a source file may have.
inline constexpr int kLineCountMax = 500;

// Checks every .h, .cc and .proto file below mosaic/, proto/, worker/, coordinator/ and tests/ of `root` against the include table of
// docs/ARCHITECTURE.md: a folder may include itself, what is below itself, and what the table grants. Sorted by file and line.
std::vector<Violation> CheckTree(const std::filesystem::path& root);

// Checks one file's text; `path` is relative to the root of the sources.
std::vector<Violation> CheckFile(const std::string& path, const std::string& text);

// Folders of the include table, bottom to top.
std::vector<std::string> Folders();

}  // namespace trem::layering
