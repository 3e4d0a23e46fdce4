// Goal: a sweep of an object store removes what no job has, and of no other coordinator's store anything. Method: GDAL's store in memory,
// whose objects are as young as the test; the rule's ages are tested in sweep_test.
#include "mosaic/raster/vsi_sweep.h"

#include <cpl_vsi.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/raster/gdal_env.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

class VsiSweepTest : public ::testing::Test {
 protected:
  VsiSweepTest() { InitialiseGdal(); }
  ~VsiSweepTest() override { VSIRmdirRecursive(root_.c_str()); }
  static void Put(const std::string& path, const std::string& bytes) {
    VSIMkdirRecursive(path.substr(0, path.rfind('/')).c_str(), 0755);  // Or this store lists no folder.
    VSILFILE* file = VSIFOpenL(path.c_str(), "wb");
    ASSERT_NE(file, nullptr);
    VSIFWriteL(bytes.data(), 1, bytes.size(), file);
    VSIFCloseL(file);
  }
  std::string ObjectPath(char digit) const { return root_ + "/objects/" + std::string(2, digit) + "/" + std::string(64, digit); }
  static bool Has(const std::string& path) {
    VSIStatBufL info{};
    return VSIStatL(path.c_str(), &info) == 0;
  }
  static SweepOptions AtOnce() {
    SweepOptions options;
    options.new_objects_stay = std::chrono::seconds(0);
    return options;
  }

  std::string root_ = "/vsimem/store";
};

TEST_F(VsiSweepTest, RemovesWhatNoJobHasAndNothingElse) {
  Put(ObjectPath('a'), "used");
  Put(ObjectPath('b'), "unused");
  Put(root_ + "/objects/readme", "not ours");
  Put(root_ + "/flight.ts", "not ours either");
  const auto report = SweepVsiStore(root_, SweepRule({std::string(64, 'a')}, {}, AtOnce()));
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->removed_objects, 1U);
  EXPECT_EQ(report->removed_bytes, 6U);
  EXPECT_EQ(report->bytes, 4U);
  EXPECT_TRUE(Has(ObjectPath('a')));
  EXPECT_FALSE(Has(ObjectPath('b')));
  EXPECT_TRUE(Has(root_ + "/objects/readme"));
  EXPECT_TRUE(Has(root_ + "/flight.ts"));
}

TEST_F(VsiSweepTest, SparesTheYoung) {
  Put(ObjectPath('b'), "unused");
  const auto report = SweepVsiStore(root_, SweepRule({}, {}, {}));
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->removed_objects, 0U);
  EXPECT_TRUE(Has(ObjectPath('b')));
}

TEST_F(VsiSweepTest, AStoreBelongsToWhoClaimedItFirst) {
  EXPECT_TRUE(ClaimVsiStore(root_, "hill").ok());
  EXPECT_TRUE(ClaimVsiStore(root_, "hill").ok());
  const Status refused = ClaimVsiStore(root_, "valley");
  EXPECT_EQ(refused.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(refused.message(), HasSubstr("belongs to the coordinator 'hill'"));
}

TEST_F(VsiSweepTest, AStoreThatIsEmptyIsNoError) { EXPECT_EQ(SweepVsiStore(root_, SweepRule({}, {}, {}))->removed_objects, 0U); }

}  // namespace
}  // namespace trem
