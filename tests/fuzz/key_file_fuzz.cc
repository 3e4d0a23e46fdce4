// Goal: no bytes in a key file crash its readers, none that a reader refuses gets into the list of those let in, and no message quotes a
// secret. Method: the bytes as a .key and as a .pub file in a folder of their own.
#include <sys/stat.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "mosaic/base/check.h"
#include "proto/channel/keys.h"
#include "tests/fuzz/scratch_folder.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::filesystem::path folder = trem::fuzz::MakeScratchFolder();
  for (const char* name : {"fuzzed.key", "fuzzed.pub"}) {
    std::ofstream(folder / name, std::ios::binary).write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
    ::chmod((folder / name).c_str(), 0600);
  }
  const auto secret = trem::ReadSecretKey(folder / "fuzzed.key");
  if (secret.ok()) TREM_CHECK(!secret->secret_key().empty() && secret->public_key().size() == 40);
  const auto key = trem::ReadPublicKey(folder / "fuzzed.pub");
  if (key.ok()) TREM_CHECK(key->secret_key().empty() && !trem::RoleName(key->role()).empty());
  const auto list = trem::AllowList::Open(folder);
  TREM_CHECK_MSG(list.ok() == key.ok(), "the list and the reader disagree");
  if (key.ok()) TREM_CHECK((*list)->Find(key->public_key()).has_value());
  return 0;
}
