#include "coordinator/cli/keys_command.h"

#include <fmt/format.h>

#include "coordinator/cli/terminal.h"
#include "proto/channel/keys.h"

namespace trem {
namespace {

Status MakeKeyFiles(const std::string& name, const std::string& role, const std::filesystem::path& folder) {
  TREM_ASSIGN_OR_RETURN(const v1::KeyFile key, MakeKey(name, RoleFromName(role).value_or(v1::ROLE_UNSPECIFIED)));
  return WriteKeyFiles(folder, key);
}

}  // namespace

int RunKeysCommand(const std::string& name, const std::string& role, const std::filesystem::path& folder) {
  const std::filesystem::path place = folder.empty() ? std::filesystem::path(".") : folder;
  if (const Status status = MakeKeyFiles(name, role, place); !status.ok()) {
    PrintError(status.message());
    return ExitCodeOf(status.code());
  }
  fmt::print("{}\n{}\n", (place / (name + ".key")).string(), (place / (name + ".pub")).string());
  return kExitDone;
}

}  // namespace trem
