#include "tests/support/paths.h"

#include <cstdlib>
#include <fstream>
#include <iterator>

#include "mosaic/base/check.h"

namespace trem::testing {
namespace fs = std::filesystem;

TempDir::TempDir() {
  const char* base = std::getenv("TMPDIR");
  std::string name = (fs::path(base != nullptr && *base != '\0' ? base : "/tmp") / "trem-test-XXXXXX").string();
  TREM_CHECK_MSG(::mkdtemp(name.data()) != nullptr, "mkdtemp " + name);
  path_ = name;
}

TempDir::~TempDir() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

fs::path BinaryPath(const std::string& name) { return fs::path(TREM_BINARY_DIR) / name; }

std::optional<fs::path> TestDataDir() {
  const char* configured = std::getenv("TREM_TEST_DATA");
  const fs::path path = configured != nullptr && *configured != '\0' ? fs::path(configured) : fs::path(TREM_SOURCE_DIR) / "../shared/data";
  std::error_code ignored;
  if (!fs::is_directory(path, ignored)) return std::nullopt;
  return fs::canonical(path);
}

std::string FileContents(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  TREM_CHECK_MSG(in.good(), "cannot read " + path.string());
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

void WriteFileContents(const fs::path& path, const std::string& bytes) {
  std::ofstream out(path, std::ios::binary);
  out << bytes;
  out.flush();
  TREM_CHECK_MSG(out.good(), "cannot write " + path.string());
}

}  // namespace trem::testing
