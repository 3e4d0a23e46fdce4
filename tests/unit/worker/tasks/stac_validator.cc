#include "tests/unit/worker/tasks/stac_validator.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <sstream>
#include <utility>
#include <vector>

#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem::testing {
namespace {

constexpr std::chrono::seconds kTimeout{120};

// As the option --schemaMap takes it: every schema in $TREM_STAC_SCHEMAS under the address that is its place there.
std::string SchemaMap() {
  const char* folder = std::getenv("TREM_STAC_SCHEMAS");
  if (folder == nullptr || *folder == '\0') return "";
  std::error_code error;
  std::string map;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder, error)) {
    if (entry.path().extension() != ".json") continue;
    map += "https://" + entry.path().lexically_relative(folder).generic_string() + "=" + entry.path().string() + ";";
  }
  EXPECT_FALSE(map.empty()) << "TREM_STAC_SCHEMAS: no schema in the folder " << folder
                            << "; expected, for example, schemas.stacspec.org/v1.0.0/item-spec/json-schema/item.json; see CONTRIBUTING.md";
  if (!map.empty()) map.pop_back();
  return map;
}

}  // namespace

StacValidator::StacValidator(std::filesystem::path folder) : folder_(std::move(folder)), schema_map_(SchemaMap()) {}

std::optional<StacValidator> StacValidator::Install(const std::filesystem::path& folder) {
  // The second major version needs a later node than the one of Debian 12.
  const Completed npm =
      RunProgram({"npm", "install", "--silent", "--no-audit", "--no-fund", "--prefix", folder.string(), "stac-node-validator@1"}, kTimeout);
  if (!npm.ended || npm.exit_code != 0) return std::nullopt;
  return StacValidator(folder);
}

StacValidator::Verdict StacValidator::Check(const std::string& item) const {
  const std::filesystem::path file = folder_ / "item.json";
  WriteFileContents(file, item);
  std::vector<std::string> argv{(folder_ / "node_modules/.bin/stac-node-validator").string(), file.string(), "--verbose"};
  if (!schema_map_.empty()) argv.insert(argv.end(), {"--schemaMap", schema_map_});
  const Completed run = RunProgram(argv, kTimeout);
  Verdict verdict;
  verdict.valid = run.ended && run.exit_code == 0;
  verdict.said = run.stdout_text + run.stderr_text;
  // Core, because its address is not the item's choice.
  verdict.without_schemas = schema_map_.empty() && verdict.said.find("item-spec/json-schema/item.json' not found") != std::string::npos;
  std::istringstream lines(run.stdout_text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t colon = line.rfind(": ");
    if (line.rfind("--- ", 0) != 0 || colon == std::string::npos) continue;
    const std::string schema = line.substr(4, colon - 4), opinion = line.substr(colon + 2);
    if (opinion == "valid") verdict.accepted_by.insert(schema);
    if (opinion == "invalid") verdict.refused_by.insert(schema);
  }
  return verdict;
}

}  // namespace trem::testing
