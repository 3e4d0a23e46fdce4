#include "proto/channel/keys.h"

#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zmq.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <system_error>

#include "mosaic/base/file.h"
#include "proto/codec/envelope.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr std::uint64_t kKeyFileBytesMax = 4096;
constexpr std::size_t kAllowedKeysMax = 100'000;
constexpr std::chrono::milliseconds kTimeResolution{100};
constexpr std::size_t kKeyChars = 40;
constexpr std::size_t kKeyBytes = 32;

// The parser's messages quote what they found, which may be the secret: they are not passed on.
class SilentCollector : public google::protobuf::io::ErrorCollector {
 public:
  void AddError(int line, google::protobuf::io::ColumnNumber, const std::string&) override {
    if (line_ < 0) line_ = line;
  }
  int line() const { return line_ + 1; }

 private:
  int line_ = -1;
};

bool IsZ85Key(const std::string& text) {
  std::array<std::uint8_t, kKeyBytes> bytes{};
  // zmq_z85_decode looks characters up without a check of their range.
  const bool is_ascii = std::all_of(text.begin(), text.end(), [](unsigned char c) { return c > 0x20 && c < 0x7f; });
  return text.size() == kKeyChars && is_ascii && zmq_z85_decode(bytes.data(), text.c_str()) != nullptr;
}

Status CheckName(const std::string& name) {
  if (IsJobId(name)) return {};
  return InvalidInput("'" + name.substr(0, 80) + "' cannot be the name of a key; expected 1 to 64 of a-z, 0-9 and '-'");
}

Result<v1::KeyFile> ReadKeyFile(const fs::path& path) {
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kKeyFileBytesMax));
  v1::KeyFile key;
  google::protobuf::TextFormat::Parser parser;
  SilentCollector errors;
  parser.RecordErrorsTo(&errors);
  if (!parser.ParseFromString(text, &key)) {
    return InvalidInput("key file " + path.string() + " is malformed in line " + std::to_string(errors.line()) +
                        "; expected name, role, public_key and secret_key as `trem keys` writes them");
  }
  TREM_RETURN_IF_ERROR(CheckName(key.name()).WithPrefix("key file " + path.string()));
  if (key.role() == v1::ROLE_UNSPECIFIED || !v1::Role_IsValid(key.role())) {
    return InvalidInput("key file " + path.string() + " has no role; expected CLIENT, WORKER, ADMIN or COORDINATOR");
  }
  if (!IsZ85Key(key.public_key()))
    return InvalidInput("key file " + path.string() + " has no usable public_key; make it anew with `trem keys`");
  return key;
}

Status CheckPrivate(const fs::path& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0) return FromErrno("cannot read key file " + path.string(), errno);
  if (!S_ISREG(info.st_mode)) return InvalidInput("key file " + path.string() + " is not a regular file");
  const bool own = info.st_uid == ::geteuid() && (info.st_mode & 077) == 0;
  const bool mounted = info.st_uid == 0 && (info.st_mode & 037) == 0;
  if (own || mounted) return {};
  return InvalidInput("key file " + path.string() +
                      " can be read or written by others than its owner; make it this user's with mode 0600 (chmod 600), and a new key if "
                      "others may have read it");
}

std::string ToText(const v1::KeyFile& key) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(key, &text);
  return text;
}

}  // namespace

Result<v1::KeyFile> MakeKey(const std::string& name, v1::Role role) {
  TREM_RETURN_IF_ERROR(CheckName(name));
  if (role == v1::ROLE_UNSPECIFIED || !v1::Role_IsValid(role))
    return InvalidInput("a key needs a role: client, worker, admin or coordinator");
  std::array<char, kKeyChars + 1> public_key{}, secret_key{};
  if (zmq_curve_keypair(public_key.data(), secret_key.data()) != 0) {
    return Failed("cannot make a CURVE key: the installed libzmq was built without CURVE");
  }
  v1::KeyFile key;
  key.set_name(name);
  key.set_role(role);
  key.set_public_key(public_key.data());
  key.set_secret_key(secret_key.data());
  return key;
}

Status WriteKeyFiles(const fs::path& folder, const v1::KeyFile& key) {
  TREM_RETURN_IF_ERROR(CheckName(key.name()));
  TREM_RETURN_IF_ERROR(MakeDirectories(folder));
  const fs::path secret = folder / (key.name() + ".key");
  const fs::path open = folder / (key.name() + ".pub");
  for (const fs::path& path : {secret, open}) {
    std::error_code error;
    if (fs::exists(fs::symlink_status(path, error))) {
      return InvalidInput(path.string() + " exists; choose another name, or remove it when nobody needs that key any more");
    }
  }
  v1::KeyFile public_half = key;
  public_half.clear_secret_key();
  TREM_RETURN_IF_ERROR(WriteFileAtomically(secret, ToText(key), 0600));
  return WriteFileAtomically(open, ToText(public_half));
}

Result<v1::KeyFile> ReadSecretKey(const fs::path& path) {
  TREM_RETURN_IF_ERROR(CheckPrivate(path));
  TREM_ASSIGN_OR_RETURN(v1::KeyFile key, ReadKeyFile(path));
  std::array<char, kKeyChars + 1> derived{};
  if (!IsZ85Key(key.secret_key()))
    return InvalidInput("key file " + path.string() + " has no secret_key; expected a .key file, not a .pub");
  if (zmq_curve_public(derived.data(), key.secret_key().c_str()) != 0 || key.public_key() != derived.data()) {
    return InvalidInput("key file " + path.string() + ": its two halves do not belong together; make it anew with `trem keys`");
  }
  return key;
}

Result<v1::KeyFile> ReadPublicKey(const fs::path& path) {
  TREM_ASSIGN_OR_RETURN(v1::KeyFile key, ReadKeyFile(path));
  if (!key.secret_key().empty()) {
    return InvalidInput(path.string() + " holds a secret key; expected the .pub file beside it");
  }
  return key;
}

Result<AllowList::Entries> AllowList::Load(const fs::path& folder, std::vector<Status>* problems) {
  Entries entries;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    if (it->path().extension() != ".pub") continue;
    const Result<v1::KeyFile> key = ReadPublicKey(it->path());
    if (!key.ok()) {
      problems->push_back(key.status());
    } else if (!entries.emplace(key->public_key(), Entry{key->name(), key->role()}).second) {
      problems->push_back(InvalidInput(it->path().string() + " holds a key that another .pub file of the folder holds too; remove one"));
    }
    if (entries.size() > kAllowedKeysMax)
      return Exhausted(folder.string() + " holds more than " + std::to_string(kAllowedKeysMax) + " keys");
  }
  if (error) return FromErrno("cannot list the folder of allowed keys " + folder.string(), error.value());
  return entries;
}

Result<std::shared_ptr<AllowList>> AllowList::Open(const fs::path& folder) {
  std::shared_ptr<AllowList> list(new AllowList(folder));
  std::error_code error;
  list->read_at_ = fs::last_write_time(folder, error);
  if (error) return FromErrno("cannot read the folder of allowed keys " + folder.string(), error.value());
  std::vector<Status> problems;
  TREM_ASSIGN_OR_RETURN(list->entries_, Load(folder, &problems));
  if (!problems.empty()) return problems.front();
  return list;
}

std::optional<AllowList::Entry> AllowList::Find(const std::string& public_key) const {
  const std::lock_guard lock(mutex_);
  Refresh();
  const auto found = entries_.find(public_key);
  return found == entries_.end() ? std::nullopt : std::optional(found->second);
}

void AllowList::Refresh() const {
  std::error_code error;
  const auto changed_at = fs::last_write_time(folder_, error);
  // Times of files are coarse: right after a change another one may bear the same time.
  if (!error && changed_at == read_at_ && fs::file_time_type::clock::now() - changed_at > kTimeResolution) return;
  const bool is_news = error || changed_at != read_at_;
  read_at_ = changed_at;
  std::vector<Status> problems;
  Result<Entries> entries = Load(folder_, &problems);
  if (!entries.ok()) problems.push_back(entries.status());
  entries_ = entries.ok() ? std::move(entries).value() : Entries();  // A folder that cannot be read lets nobody in.
  if (!is_news) return;
  for (const Status& problem : problems) spdlog::warn("allowed keys: {}", problem.message());
  spdlog::info("allowed keys: {} in {}", entries_.size(), folder_.string());
}

std::string RoleName(v1::Role role) {
  std::string name = v1::Role_IsValid(role) ? v1::Role_Name(role) : "unknown";
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return name;
}

std::optional<v1::Role> RoleFromName(const std::string& name) {
  for (const v1::Role role : {v1::CLIENT, v1::WORKER, v1::ADMIN, v1::COORDINATOR}) {
    if (RoleName(role) == name) return role;
  }
  return std::nullopt;
}

}  // namespace trem
