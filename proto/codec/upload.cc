#include "proto/codec/upload.h"

#include <charconv>
#include <set>

#include "mosaic/base/digest.h"

namespace trem {
namespace {

constexpr std::string_view kPrefix = "upload-";
constexpr std::size_t kDigestChars = 64;
constexpr std::size_t kNameBytesMax = 1024;

// Parts between slashes, none of them empty, "." or "..".
bool IsPlainRelative(std::string_view name) {
  if (name.empty() || name.size() > kNameBytesMax || name.find('\0') != std::string_view::npos) return false;
  while (true) {
    const std::size_t slash = name.find('/');
    const std::string_view part = name.substr(0, slash);
    if (part.empty() || part == "." || part == "..") return false;
    if (slash == std::string_view::npos) return true;
    name.remove_prefix(slash + 1);
  }
}

}  // namespace

std::string UploadName(const ArtefactRef& list) { return std::string(kPrefix) + list.sha256 + "-" + std::to_string(list.bytes); }

std::optional<ArtefactRef> UploadOfPath(std::string_view path) {
  if (!path.starts_with(kPrefix) || !IsPlainRelative(path)) return std::nullopt;
  const std::string_view name = path.substr(0, path.find('/'));
  if (name.size() < kPrefix.size() + kDigestChars + 2 || name[kPrefix.size() + kDigestChars] != '-') return std::nullopt;
  ArtefactRef ref{"upload.pb", std::string(name.substr(kPrefix.size(), kDigestChars)), 0};
  const std::string_view bytes = name.substr(kPrefix.size() + kDigestChars + 1);
  const auto [end, error] = std::from_chars(bytes.data(), bytes.data() + bytes.size(), ref.bytes);
  if (error != std::errc() || end != bytes.data() + bytes.size() || !IsSha256Hex(ref.sha256)) return std::nullopt;
  return ref;
}

Status CheckUploadList(const v1::UploadList& list) {
  std::set<std::string_view> names;
  for (const v1::UploadedFile& file : list.files()) {
    if (!IsPlainRelative(file.name()))
      return Corrupt("an upload holds a file named '" + file.name().substr(0, 80) + "'; expected a relative path");
    if (!names.insert(file.name()).second) return Corrupt("an upload holds the file '" + file.name() + "' twice");
    if (!IsSha256Hex(file.sha256())) return Corrupt("file '" + file.name() + "' of an upload has no digest");
  }
  return {};
}

}  // namespace trem
