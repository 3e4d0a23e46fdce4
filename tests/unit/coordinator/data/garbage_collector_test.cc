// Goal: a sweep removes what no job has, and nothing else. Method: objects of all kinds, made older by hand.
#include "coordinator/data/garbage_collector.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::hours;
using std::chrono::minutes;

class GarbageCollectorTest : public ::testing::Test {
 protected:
  // An object that was put so long ago.
  std::string Put(const std::string& content, std::chrono::seconds age) {
    const ArtefactRef ref = store_.PutBytes("a", content).value();
    fs::last_write_time(store_.Locate(ref).value(), fs::file_time_type::clock::now() - age);
    return ref.sha256;
  }
  bool Has(const std::string& digest) const {
    std::uint64_t bytes = 0;
    return store_.Find(digest, &bytes).ok();
  }
  SweepReport Sweep(std::vector<std::string> in_use, std::vector<std::string> released) {
    const SweepOptions options;
    return SweepStore(store_, SweepRule(std::move(in_use), std::move(released), options), options.new_objects_stay, false).value();
  }

  testing::TempDir folder_;
  ArtefactStore store_ = ArtefactStore::Open(folder_ / "store").value();
};

TEST_F(GarbageCollectorTest, RemovesWhatNoJobHas) {
  const std::string used = Put("used", hours(100));
  const std::string unused = Put("unused", hours(100));
  const SweepReport report = Sweep({used}, {});
  EXPECT_TRUE(Has(used));
  EXPECT_FALSE(Has(unused));
  EXPECT_EQ(report.removed_objects, 1U);
  EXPECT_EQ(report.removed_bytes, 6U);
  EXPECT_EQ(report.bytes, 4U);
}

TEST_F(GarbageCollectorTest, SparesWhatMayNotYetBeCommitted) {
  const std::string young = Put("young", hours(2));
  const std::string released = Put("released", hours(2));
  const std::string released_and_put_again = Put("again", minutes(0));
  Sweep({}, {released, released_and_put_again});
  EXPECT_TRUE(Has(young));
  EXPECT_FALSE(Has(released));
  EXPECT_TRUE(Has(released_and_put_again));
}

TEST_F(GarbageCollectorTest, PuttingAgainMakesYoung) {
  const std::string digest = Put("content", hours(100));
  ASSERT_TRUE(store_.PutBytes("b", "content").ok());
  Sweep({}, {digest});
  EXPECT_TRUE(Has(digest));
}

TEST_F(GarbageCollectorTest, RemovesOldTemporaryFilesAndTouchesNothingElse) {
  const auto put = [&](const std::string& name) {
    testing::WriteFileContents(store_.root() / name, "x");
    fs::last_write_time(store_.root() / name, fs::file_time_type::clock::now() - hours(100));
  };
  fs::create_directories(store_.root() / "tmp/trem-worker-abc");
  for (const char* name : {"tmp/1-2.tif", "tmp/trem-worker-abc/lock", "objects/readme.txt", "note"}) put(name);
  testing::WriteFileContents(store_.root() / "tmp/young.part", "x");
  fs::create_symlink(store_.root() / "note", store_.root() / "tmp/link");
  EXPECT_EQ(Sweep({}, {}).removed_objects, 0U);
  EXPECT_FALSE(fs::exists(store_.root() / "tmp/1-2.tif"));
  for (const char* name : {"tmp/trem-worker-abc/lock", "objects/readme.txt", "note", "tmp/young.part"}) {
    EXPECT_TRUE(fs::exists(store_.root() / name)) << name;
  }
  EXPECT_TRUE(fs::is_symlink(store_.root() / "tmp/link"));
}

TEST_F(GarbageCollectorTest, TheCollectorLetsGoOfWhatIsNoLongerInUse) {
  const std::string stays = Put("stays", hours(2));
  const std::string goes = Put("goes", hours(2));
  GarbageCollector collector(store_, {});
  const auto sweep = [&](const std::vector<std::string>& in_use, const std::vector<std::string>& released) {
    collector.Begin(in_use, released);
    for (int i = 0; i < 1000; ++i) {
      if (const auto report = collector.TakeReport()) return report->bytes;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return std::uint64_t{0};
  };
  EXPECT_EQ(sweep({goes, stays, stays}, {}), 9U);
  EXPECT_EQ(sweep({stays}, {}), 9U) << "nobody has said that it was let go of";
  EXPECT_EQ(sweep({stays}, {stays, goes, goes}), 5U);
  EXPECT_TRUE(Has(stays));
  EXPECT_FALSE(Has(goes));
}

}  // namespace
}  // namespace trem
