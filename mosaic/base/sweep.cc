#include "mosaic/base/sweep.h"

#include <algorithm>
#include <utility>

#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"

namespace trem {
namespace {

constexpr std::size_t kDigestBytes = 32;

unsigned ValueOf(char digit) { return static_cast<unsigned>(digit <= '9' ? digit - '0' : digit - 'a' + 10); }

}  // namespace

SweepRule::SweepRule(std::vector<std::string> in_use, std::vector<std::string> released, const SweepOptions& options)
    : in_use_(std::move(in_use)), released_(std::move(released)), options_(options) {
  std::sort(in_use_.begin(), in_use_.end());
  std::sort(released_.begin(), released_.end());
}

bool SweepRule::MayGo(const std::string& digest, std::chrono::seconds age) const {
  const bool was_released = std::binary_search(released_.begin(), released_.end(), digest);
  const auto stays = was_released ? options_.released_objects_stay : options_.new_objects_stay;
  return age >= stays && !std::binary_search(in_use_.begin(), in_use_.end(), digest);
}

std::string PackDigests(const std::vector<std::string>& digests) {
  std::string bytes;
  bytes.reserve(kDigestBytes * digests.size());
  for (const std::string& digest : digests) {
    TREM_CHECK(IsSha256Hex(digest));
    for (std::size_t i = 0; i < digest.size(); i += 2) bytes += static_cast<char>(ValueOf(digest[i]) << 4 | ValueOf(digest[i + 1]));
  }
  return bytes;
}

Result<std::vector<std::string>> UnpackDigests(std::string_view bytes) {
  static constexpr char kDigits[] = "0123456789abcdef";
  if (bytes.size() % kDigestBytes != 0)
    return Corrupt("a list of digests has " + std::to_string(bytes.size()) + " bytes; expected a multiple of 32");
  std::vector<std::string> digests(bytes.size() / kDigestBytes);
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const auto byte = static_cast<unsigned char>(bytes[i]);
    digests[i / kDigestBytes] += {kDigits[byte >> 4], kDigits[byte & 15]};
  }
  return digests;
}

}  // namespace trem
