// Goal: what the store returns is what was put, whatever happened to the file in between. Method: objects put, damaged by hand and put or
// read again.
#include "mosaic/base/artefact_store.h"

#include <gtest/gtest.h>

#include "tests/support/paths.h"

namespace trem {
namespace {

using testing::FileContents;
using testing::TempDir;
using testing::WriteFileContents;

TEST(ArtefactStoreTest, PutsGoodBytesInThePlaceOfDamagedOnesOfAnySize) {
  const TempDir folder;
  const ArtefactStore store = *ArtefactStore::Open(folder.path());
  const ArtefactRef ref = *store.PutBytes("a", "the bytes");
  const std::filesystem::path path = *store.Locate(ref);
  for (const std::string& damage : {"the bytez", "the", ""}) {
    WriteFileContents(path, damage);
    EXPECT_EQ(store.ReadVerified(ref, 100).status().code(), StatusCode::kCorrupt) << damage;
    ASSERT_TRUE(store.PutBytes("a", "the bytes").ok());
    EXPECT_EQ(store.ReadVerified(ref, 100).value(), "the bytes") << damage;
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder / "tmp")) << "a temporary file was left";
}

}  // namespace
}  // namespace trem
