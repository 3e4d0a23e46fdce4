#include "mosaic/base/digest.h"

#include <fcntl.h>
#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <memory>

#include "mosaic/base/open_file.h"

// The library's header is its implementation too: nothing has to be installed where the programs run.
#define XXH_INLINE_ALL
#include <xxhash.h>

namespace trem {

struct Sha256::State {
  EVP_MD_CTX* context = nullptr;
};

Sha256::Sha256() : state_(std::make_unique<State>()) {
  state_->context = EVP_MD_CTX_new();
  TREM_CHECK(state_->context != nullptr);
  TREM_CHECK(EVP_DigestInit_ex(state_->context, EVP_sha256(), nullptr) == 1);
}

Sha256::~Sha256() { EVP_MD_CTX_free(state_->context); }

void Sha256::Update(std::string_view bytes) { TREM_CHECK(EVP_DigestUpdate(state_->context, bytes.data(), bytes.size()) == 1); }

std::string Sha256::FinishHex() {
  std::array<unsigned char, 32> hash{};
  unsigned int length = 0;
  TREM_CHECK(EVP_DigestFinal_ex(state_->context, hash.data(), &length) == 1 && length == hash.size());
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string hex;
  hex.reserve(64);
  for (const unsigned char byte : hash) {
    hex.push_back(kDigits[byte >> 4]);
    hex.push_back(kDigits[byte & 15]);
  }
  return hex;
}

std::string Sha256Hex(std::string_view bytes) {
  Sha256 sha;
  sha.Update(bytes);
  return sha.FinishHex();
}

std::uint64_t Xxh3(std::string_view bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

Result<std::string> Sha256HexOfFile(const std::filesystem::path& path) {
  // Stays in the second cache between being read and being digested.
  constexpr std::uint64_t kBlockBytes = std::uint64_t{256} << 10;
  TREM_ASSIGN_OR_RETURN(const OpenFile file, OpenFile::Open(path, O_RDONLY));
  TREM_ASSIGN_OR_RETURN(const std::uint64_t bytes, file.Size());
  const auto block = std::make_unique_for_overwrite<char[]>(std::min(bytes, kBlockBytes));
  Sha256 sha;
  for (std::uint64_t offset = 0; offset < bytes;) {
    const std::span<char> piece(block.get(), std::min(bytes - offset, kBlockBytes));
    TREM_RETURN_IF_ERROR(file.ReadAt(offset, piece));
    sha.Update({piece.data(), piece.size()});
    offset += piece.size();
  }
  return sha.FinishHex();
}

bool IsSha256Hex(std::string_view text) {
  return text.size() == 64 && std::ranges::all_of(text, [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

}  // namespace trem
