#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// Incremental SHA-256 (OpenSSL).
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  void Update(std::string_view bytes);
  // 64 lower-case hexadecimal digits. Call once.
  std::string FinishHex();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

std::string Sha256Hex(std::string_view bytes);
// XXH3, 64 bits: finds accidental damage at memory speed. Proves nothing against whoever wants to deceive.
std::uint64_t Xxh3(std::string_view bytes);
// Reads the file in blocks; errors name the path.
Result<std::string> Sha256HexOfFile(const std::filesystem::path& path);
// True for exactly 64 lower-case hexadecimal digits: the only strings that may become part of an artefact's path.
bool IsSha256Hex(std::string_view text);

}  // namespace trem
