// Feeds arbitrary bytes to both spec readers and to the overrides; whatever is accepted must survive CompleteSortie twice.
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "mosaic/base/check.h"
#include "proto/codec/sortie_spec.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  for (const char* name : {"fuzz.json", "fuzz.textproto"}) {
    auto sortie = trem::ParseSortieSpec(text, name);
    if (sortie.ok() && trem::CompleteSortie(&*sortie).ok()) TREM_CHECK(trem::CompleteSortie(&*sortie).ok());
  }
  trem::v1::Sortie sortie;
  if (!trem::ApplyOverride(text, &sortie).ok()) return 0;
  sortie.mutable_source()->set_path("x");
  (void)trem::CompleteSortie(&sortie).ok();
  return 0;
}
