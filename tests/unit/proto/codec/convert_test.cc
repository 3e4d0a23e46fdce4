// Goal: grids over scenes survive their message, and a damaged one is refused by its field. Method: round trips, then one number spoiled at a time.
#include "proto/codec/convert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <vector>

namespace trem {
namespace {

using ::testing::HasSubstr;

CellShifts SomeShifts() {
  CellShifts shifts = CellShifts::Over({-4.5, 2.0}, {60.0, 30.0}, 24.0, Eigen::Vector2d::Zero());
  for (std::size_t i = 0; i < shifts.values.size(); ++i) shifts.values[i] = {0.25 * static_cast<double>(i), -0.5 * static_cast<double>(i)};
  return shifts;
}

TEST(CellGridMessage, GivesBackWhatWentIn) {
  const CellShifts shifts = SomeShifts();
  v1::CellGrid message;
  ToProto(shifts, &message);
  const Result<CellShifts> back = CellShiftsFromProto(message, "relief");
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->first, shifts.first);
  EXPECT_EQ(back->columns, shifts.columns);
  EXPECT_EQ(back->values, shifts.values);
  EXPECT_TRUE(CellShiftsFromProto({}, "relief")->empty());
  EXPECT_TRUE(CellGridFromProto({}, "shade")->empty());
}

TEST(CellGridMessage, IsRefusedWhenItIsNoGrid) {
  const std::vector<std::function<void(v1::CellGrid*)>> faults = {
      [](v1::CellGrid* m) { m->mutable_values()->RemoveLast(); },
      [](v1::CellGrid* m) { m->set_columns(4'000'000'000U); },
      [](v1::CellGrid* m) { m->set_rows(0); },
      [](v1::CellGrid* m) { m->set_step(0.0); },
      [](v1::CellGrid* m) { m->set_first_x(std::nan("")); },
      [](v1::CellGrid* m) { m->set_values(3, std::numeric_limits<float>::infinity()); },
      [](v1::CellGrid* m) { m->clear_values(); },
  };
  for (std::size_t i = 0; i < faults.size(); ++i) {
    v1::CellGrid message;
    ToProto(SomeShifts(), &message);
    faults[i](&message);
    const Result<CellShifts> grid = CellShiftsFromProto(message, "AlignedScene.relief");
    ASSERT_FALSE(grid.ok()) << i;
    EXPECT_EQ(grid.status().code(), StatusCode::kCorrupt);
    EXPECT_THAT(grid.status().message(), HasSubstr("AlignedScene.relief"));
  }
}

}  // namespace
}  // namespace trem
