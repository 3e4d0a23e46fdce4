#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/keys.pb.h"

namespace trem {

// A fresh CURVE key pair. Errors: kInvalidInput for a name that is not [a-z0-9-]{1,64}, or no role.
Result<v1::KeyFile> MakeKey(const std::string& name, v1::Role role);

// Writes <folder>/<name>.key (mode 0600) and <folder>/<name>.pub (0644). Never overwrites: an existing file is kInvalidInput.
Status WriteKeyFiles(const std::filesystem::path& folder, const v1::KeyFile& key);

// Reads a .key file. A file that others can read is refused: it has to be this user's with mode 0600 or stricter, or root's with 0640 or
// stricter (as a mounted secret is). Errors name the file and never quote its content.
Result<v1::KeyFile> ReadSecretKey(const std::filesystem::path& path);
// Reads a .pub file; one that holds a secret is refused, so that nobody hands it round.
Result<v1::KeyFile> ReadPublicKey(const std::filesystem::path& path);

// The keys that a coordinator lets in: every *.pub of a folder. Adding or removing a file takes effect at once, for connections that
// stand too. Thread-safe.
class AllowList {
 public:
  // Errors: the folder cannot be read, or holds a .pub file that is none, or the same key twice. Later such files are left out, with a
  // warning in the log, and a folder that is gone lets nobody in.
  static Result<std::shared_ptr<AllowList>> Open(const std::filesystem::path& folder);

  struct Entry {
    std::string name;
    v1::Role role = v1::ROLE_UNSPECIFIED;
  };
  // Nullopt: not allowed in. `public_key` is Z85.
  std::optional<Entry> Find(const std::string& public_key) const;

 private:
  using Entries = std::map<std::string, Entry>;
  explicit AllowList(std::filesystem::path folder) : folder_(std::move(folder)) {}
  static Result<Entries> Load(const std::filesystem::path& folder, std::vector<Status>* problems);
  void Refresh() const;

  std::filesystem::path folder_;
  mutable std::mutex mutex_;
  mutable std::filesystem::file_time_type read_at_;  // The folder's time of change when it was read.
  mutable Entries entries_;
};

// Lower-case name, "worker"; and back: nullopt for a word that is no role.
std::string RoleName(v1::Role role);
std::optional<v1::Role> RoleFromName(const std::string& name);

}  // namespace trem
