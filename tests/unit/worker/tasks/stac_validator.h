#pragma once

#include <filesystem>
#include <optional>
#include <set>
#include <string>

namespace trem::testing {

// The npm package stac-node-validator. Its schemas come from the folder that TREM_STAC_SCHEMAS names (CONTRIBUTING.md says what lies there
// and how), from the network where that is not set.
class StacValidator {
 public:
  struct Verdict {
    bool valid = false;
    bool without_schemas = false;  // TREM_STAC_SCHEMAS is not set and the network gives none: nothing was checked.
    // Schemas by what they make of the item: "Item", the core's, and the addresses of extensions. Those that it could not read are in
    // neither. An item that the core refuses is not held against extensions.
    std::set<std::string> accepted_by, refused_by;
    std::string said;
  };

  // Installs it into `folder`, which is made. Nullopt when npm cannot.
  static std::optional<StacValidator> Install(const std::filesystem::path& folder);

  // `item`: the JSON text.
  Verdict Check(const std::string& item) const;

 private:
  explicit StacValidator(std::filesystem::path folder);

  std::filesystem::path folder_;
  std::string schema_map_;  // "address=file;..."; empty: from the network.
};

}  // namespace trem::testing
