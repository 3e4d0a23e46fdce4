#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace trem::testing {

// A fresh folder that is removed with everything in it when the object dies.
class TempDir {
 public:
  TempDir();
  ~TempDir();
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;

  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

// A program of this build, for example BinaryPath("trem").
std::filesystem::path BinaryPath(const std::string& name);

// Shared sample data that lies outside the repository: $TREM_TEST_DATA, else ../shared/data beside the source tree. Absent on most
// machines: a test that needs it prints why and skips.
std::optional<std::filesystem::path> TestDataDir();

// Whole content of a file. These two abort the test program with the path when the file cannot be read or written.
std::string FileContents(const std::filesystem::path& path);
void WriteFileContents(const std::filesystem::path& path, const std::string& bytes);

}  // namespace trem::testing
