// Feeds arbitrary bytes to what reads uploads: as a path of a spec, and as a list of files. No file of a list that is accepted leads out of
// the folder that it is put into, and a path that is taken for an upload's names that upload again.
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string_view>

#include "mosaic/base/check.h"
#include "proto/codec/upload.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  if (const auto list = trem::UploadOfPath(bytes)) {
    const auto again = trem::UploadOfPath(trem::UploadName(*list));
    TREM_CHECK(again && again->sha256 == list->sha256 && again->bytes == list->bytes);
  }
  trem::v1::UploadList list;
  if (!list.ParseFromArray(data, static_cast<int>(size)) || !trem::CheckUploadList(list).ok()) return 0;
  const std::filesystem::path root = "/inputs/upload";
  for (const trem::v1::UploadedFile& file : list.files()) {
    const std::filesystem::path inside = (root / file.name()).lexically_normal().lexically_relative(root);
    TREM_CHECK(!inside.empty() && *inside.begin() != ".." && *inside.begin() != ".");
  }
  return 0;
}
