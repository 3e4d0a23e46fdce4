#include "tests/layering/layering_rules.h"

#include <algorithm>
#include <array>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>
#include <string_view>

namespace trem::layering {
namespace {

namespace fs = std::filesystem;

// What a folder may touch of the outside world.
enum class Reach {
  kPure,      // Nothing: no clock, disk, socket, thread or source of randomness.
  kNoPixels,  // Anything but OpenCV, GDAL and FFmpeg.
  kPixels,    // Anything.
};

// What a folder may include of this project, itself and its subfolders apart.
struct Rule {
  std::string_view folder;
  std::vector<std::string_view> allowed;
  Reach reach;
};

// The include table. The first rule whose folder holds the file counts, so subfolders stand before their parents.
const std::vector<Rule>& Rules() {
  static const std::vector<Rule> rules = {
      {"mosaic/base", {}, Reach::kNoPixels},
      {"mosaic/geometry", {"mosaic/base"}, Reach::kNoPixels},
      {"mosaic/raster", {"mosaic/base", "mosaic/geometry"}, Reach::kPixels},
      {"mosaic/align", {"mosaic/base", "mosaic/geometry"}, Reach::kPixels},
      {"mosaic/composite", {"mosaic/base", "mosaic/geometry", "mosaic/raster"}, Reach::kPixels},
      {"mosaic/publish", {"mosaic/base", "mosaic/geometry", "mosaic/raster"}, Reach::kPixels},
      {"proto/trem", {}, Reach::kNoPixels},
      {"proto/codec", {"mosaic/base", "mosaic/geometry", "proto/trem"}, Reach::kNoPixels},
      {"proto/channel", {"mosaic/base", "mosaic/geometry", "proto/trem", "proto/codec"}, Reach::kNoPixels},
      {"worker/telemetry", {"mosaic/base", "mosaic/geometry", "mosaic/raster"}, Reach::kNoPixels},
      {"worker/sortie", {"mosaic/base", "mosaic/geometry", "mosaic/raster", "proto", "worker/telemetry"}, Reach::kPixels},
      {"worker/sensor", {"mosaic/base", "mosaic/geometry"}, Reach::kPixels},
      {"worker/registration", {"mosaic/base", "mosaic/geometry", "worker/sensor"}, Reach::kPixels},
      {"worker/tre", {"mosaic/base", "mosaic/geometry", "worker/registration", "worker/sensor"}, Reach::kPixels},
      {"worker/simulate", {"mosaic/base", "mosaic/geometry", "mosaic/raster"}, Reach::kPixels},
      {"worker/tasks",
       {"mosaic", "proto/trem", "proto/codec", "worker/telemetry", "worker/sortie", "worker/sensor", "worker/registration", "worker/tre"},
       Reach::kPixels},
      {"worker/app", {"mosaic", "proto", "worker"}, Reach::kPixels},
      {"coordinator/planning", {"mosaic/base", "mosaic/geometry", "proto/trem", "proto/codec"}, Reach::kPure},
      {"coordinator/scheduling", {"mosaic/base", "mosaic/geometry", "proto/trem", "proto/codec", "coordinator/planning"}, Reach::kPure},
      {"coordinator/store", {"mosaic/base", "proto"}, Reach::kNoPixels},
      {"coordinator/data", {"mosaic/base", "proto"}, Reach::kNoPixels},
      {"coordinator/http", {"mosaic/base"}, Reach::kNoPixels},
      {"coordinator/cli", {"mosaic/base", "mosaic/geometry", "proto", "coordinator/planning"}, Reach::kNoPixels},
      {"coordinator/app", {"mosaic/base", "mosaic/geometry", "proto", "coordinator"}, Reach::kNoPixels},
      {"tests", {"mosaic", "proto", "worker", "coordinator", "tests"}, Reach::kPixels},
  };
  return rules;
}

bool IsWithin(std::string_view path, std::string_view folder) {
  return path.size() > folder.size() && path.substr(0, folder.size()) == folder && path[folder.size()] == '/';
}

bool IsProjectPath(std::string_view path) {
  static constexpr std::array<std::string_view, 5> kTop = {"mosaic", "proto", "worker", "coordinator", "tests"};
  return std::any_of(kTop.begin(), kTop.end(), [&](std::string_view top) { return IsWithin(path, top); });
}

bool IsPixelLibrary(const std::string& header) {
  static const std::regex pattern(
      R"(^(opencv2/.*|opencv.*|gdal.*|ogr[a-z0-9_]*\.h|cpl_[a-z0-9_]*\.h|vrtdataset\.h|libav[a-z]*/.*|libsw[a-z]*/.*)$)");
  return std::regex_match(header, pattern);
}

bool IsOutsideWorld(const std::string& header) {
  static const std::regex pattern(
      R"(^(chrono|ctime|time\.h|random|thread|mutex|future|fstream|filesystem|unistd\.h|sys/.*|zmq.*|sqlite3\.h|mosaic/base/(file|artefact_store|log)\.h)$)");
  return std::regex_match(header, pattern);
}

std::string Join(const std::vector<std::string_view>& words) {
  std::string joined;
  for (const std::string_view word : words) joined += (joined.empty() ? "" : ", ") + std::string(word);
  return joined.empty() ? "nothing" : joined;
}

const Rule* FindRule(const std::string& path) {
  const auto rule = std::find_if(Rules().begin(), Rules().end(), [&](const Rule& r) { return IsWithin(path, r.folder); });
  return rule == Rules().end() ? nullptr : &*rule;
}

// Empty when `header`, included by a file under `rule`, is allowed.
std::string Objection(const Rule& rule, const std::string& header) {
  if (IsPixelLibrary(header)) {
    return rule.reach == Reach::kPixels ? "" : "includes <" + header + ">, but " + std::string(rule.folder) + " never opens a pixel";
  }
  if (rule.reach == Reach::kPure && IsOutsideWorld(header)) {
    return "includes " + header + ", but " + std::string(rule.folder) + " is pure: no clock, disk, socket, thread or random source";
  }
  if (header.find("..") != std::string::npos) return "includes \"" + header + "\"; expected a full path from the root of the sources";
  if (!IsProjectPath(header) || IsWithin(header, rule.folder)) return "";
  for (const std::string_view folder : rule.allowed) {
    if (IsWithin(header, folder)) return "";
  }
  return "includes \"" + header + "\", but " + std::string(rule.folder) + " may include " + Join(rule.allowed);
}

}  // namespace

std::string ToString(const std::vector<Violation>& violations) {
  std::string text;
  for (const Violation& v : violations) text += v.file + ":" + std::to_string(v.line) + ": " + v.what + "\n";
  return text;
}

std::vector<std::string> Folders() {
  std::vector<std::string> folders;
  for (const Rule& rule : Rules()) folders.emplace_back(rule.folder);
  return folders;
}

std::vector<Violation> CheckFile(const std::string& path, const std::string& text) {
  static const std::regex include_line(R"re(^\s*(?:#\s*include\s*[<"]([^>"]+)[>"]|import\s+(?:public\s+)?"([^"]+)"\s*;).*)re");
  std::vector<Violation> violations;
  const Rule* rule = FindRule(path);
  if (rule == nullptr) {
    violations.push_back(
        {path, 0, "lies in a folder that the include table does not know; add it to tests/layering and docs/ARCHITECTURE.md"});
    return violations;
  }
  std::istringstream lines(text);
  std::string line;
  int number = 0;
  while (std::getline(lines, line)) {
    ++number;
    std::smatch match;
    if (!std::regex_match(line, match, include_line)) continue;
    std::string what = Objection(*rule, match[1].matched ? match[1].str() : match[2].str());
    if (!what.empty()) violations.push_back({path, number, std::move(what)});
  }
  if (number > kLineCountMax) {
    violations.push_back({path, number, "has " + std::to_string(number) + " lines; split it, at most " + std::to_string(kLineCountMax)});
  }
  return violations;
}

std::vector<Violation> CheckTree(const fs::path& root) {
  static const std::set<std::string> extensions = {".h", ".cc", ".proto"};
  std::vector<std::string> paths;
  for (const char* top : {"mosaic", "proto", "worker", "coordinator", "tests"}) {
    if (!fs::is_directory(root / top)) continue;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root / top)) {
      if (!entry.is_regular_file() || !extensions.contains(entry.path().extension().string())) continue;
      paths.push_back(fs::relative(entry.path(), root).generic_string());
    }
  }
  std::sort(paths.begin(), paths.end());
  std::vector<Violation> violations;
  for (const std::string& path : paths) {
    std::ifstream file(root / path);
    std::ostringstream text;
    text << file.rdbuf();
    for (Violation& v : CheckFile(path, text.str())) violations.push_back(std::move(v));
  }
  return violations;
}

}  // namespace trem::layering
