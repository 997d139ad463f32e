// What stands above a plant without being joined to it.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/detached_tops.hpp"

namespace field_phenotyping {
namespace {

/// A row of plants 20 cm apart: a short one, 0, and taller ones. The soil is at height 0.
struct Row {
  Block block;
  PointOwners owners;
  PointOwners isolated;
  std::int32_t plants = 4;
  float step = 0.005F;  // [m] from point to point, upwards

  static constexpr float kShort = 1.6F;
  static constexpr float kTall = 2.2F;

  static Eigen::Vector3f placeOf(std::int32_t plant, float z) {
    return {0.2F * static_cast<float>(plant), 0.0F, z};
  }

  std::uint32_t add(const Eigen::Vector3f& point, std::int32_t plant) {
    block.cloud.points.push_back(point);
    owners.stem.push_back(-1);
    owners.plant.push_back(plant);
    return static_cast<std::uint32_t>(owners.plant.size() - 1U);
  }
  std::uint32_t addIsolated(const Eigen::Vector3f& point, std::int32_t plant) {
    block.isolated.points.push_back(point);
    isolated.stem.push_back(-1);
    isolated.plant.push_back(plant);
    return static_cast<std::uint32_t>(isolated.plant.size() - 1U);
  }
  void grow() {
    for (float z = 0.0F; z < kShort; z += step) add({0.0F, 0.0F, z}, 0);
    for (std::int32_t plant = 1; plant < plants; ++plant) {
      for (float z = 0.0F; z < kTall; z += step) add(placeOf(plant, z), plant);
    }
  }
  /// A branch of the tall plant that ends right above the short one; its end is held by that.
  std::vector<std::uint32_t> addBranch(float z = 1.9F) {
    std::vector<std::uint32_t> end;
    for (float x = 0.2F; x >= 0.0F; x -= step) {
      const bool is_held = x < 0.04F;
      const std::uint32_t i = add({x, 0.0F, z}, is_held ? 0 : 1);
      if (is_held) end.push_back(i);
    }
    return end;
  }
  std::vector<float> give() {
    const NeighborGrid grid(block.cloud.points, 0.025F);
    return giveDetachedTops(block, grid, static_cast<std::size_t>(plants), owners, isolated);
  }
};

TEST(DetachedTops, GoToThePlantThatTheyAreJoinedTo) {
  Row row;
  row.grow();
  const std::vector<std::uint32_t> end = row.addBranch();
  const std::vector<float> doubt = row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 1);
  // One in ten is given away wrongly, and the top was 30 cm higher.
  EXPECT_NEAR(doubt[0], std::sqrt(0.1F) * 0.3F, 0.005F);
  EXPECT_EQ(doubt[1], 0.0F);
}

TEST(DetachedTops, StayWhereNothingOfAnotherPlantIsNear) {
  Row row;
  row.grow();
  const std::uint32_t tip = row.add({0.0F, 0.0F, 1.8F}, 0);
  row.give();
  EXPECT_EQ(row.owners.plant[tip], 0);
}

TEST(DetachedTops, StayWherePlantsAreBadlySeen) {
  Row row;
  row.step = 0.08F;
  row.grow();
  row.step = 0.01F;
  const std::vector<std::uint32_t> end = row.addBranch();
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 0);
}

TEST(DetachedTops, StayWherePlantsUsuallyHaveSuchGaps) {
  for (const bool have_gaps : {false, true}) {
    Row row;
    row.grow();
    for (std::int32_t plant = 1; have_gaps && plant < row.plants; ++plant) {
      row.add(Row::placeOf(plant, Row::kTall + 0.035F), plant);
    }
    const std::vector<std::uint32_t> end = row.addBranch(Row::kShort + 0.05F);
    row.give();
    for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], have_gaps ? 0 : 1);
  }
}

TEST(DetachedTops, StayWhereOthersHaveSuchGapsWithNoPlantNear) {
  for (const bool are_near : {false, true}) {
    Row row;
    row.plants = 8;
    row.grow();
    const std::vector<std::uint32_t> end = row.addBranch();
    row.add(Row::placeOf(2, Row::kTall + 0.35F), 2);
    row.add(Row::placeOf(3, Row::kTall + 0.35F), 3);
    // Two such tops say that the short one's is its own, if tops have often another plant near.
    for (std::int32_t plant = 4; are_near && plant < row.plants; ++plant) {
      row.add(Row::placeOf(plant, Row::kTall - 0.01F) + Eigen::Vector3f(0.03F, 0.0F, 0.0F), 2);
    }
    row.give();
    for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], are_near ? 0 : 1);
  }
}

TEST(DetachedTops, GoToNoneWhereTheyWouldRaiseTheOtherAsMuch) {
  Row row;
  row.grow();
  std::vector<std::uint32_t> high;
  for (float z = Row::kTall; z < Row::kTall + 0.4F; z += z < Row::kTall + 0.1F ? 0.01F : 0.05F) {
    high.push_back(row.add(Row::placeOf(1, z), 0));
  }
  row.give();
  for (const std::uint32_t i : high) EXPECT_EQ(row.owners.plant[i], -1);
}

TEST(DetachedTops, AreFoundBesideThePlantToo) {
  // The end of the neighbour's branch hangs 8 cm beside the short plant, as high as its own top.
  Row row;
  row.grow();
  std::vector<std::uint32_t> end;
  for (float x = 0.2F; x >= 0.08F; x -= row.step) {
    const bool is_held = x < 0.12F;
    const std::uint32_t i = row.add({x, 0.0F, Row::kShort + 0.03F}, is_held ? 0 : 1);
    if (is_held) end.push_back(i);
  }
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 1);
}

TEST(DetachedTops, GoOneBelowTheOther) {
  Row row;
  row.grow();
  std::vector<std::uint32_t> ends = row.addBranch();
  for (const std::uint32_t i : row.addBranch(1.75F)) ends.push_back(i);
  row.give();
  for (const std::uint32_t i : ends) EXPECT_EQ(row.owners.plant[i], 1);
}

TEST(DetachedTops, PointsTakenForOutliersBridgeGapsAndMayBeGiven) {
  Row row;
  row.grow();
  const std::vector<std::uint32_t> end = row.addBranch();
  const std::uint32_t lone = row.addIsolated({0.0F, 0.02F, 1.91F}, 0);
  for (float z = Row::kShort; z < 1.9F; z += row.step) row.addIsolated({0.0F, 0.0F, z}, 0);
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 0);
  row.isolated.plant.resize(1U);
  row.isolated.stem.resize(1U);
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 1);
  EXPECT_EQ(row.isolated.plant[lone], 1);
}

TEST(DetachedTops, AStemsStayButAFewOfItsPointsThatFollowedTheNeighboursGo) {
  for (const bool follows : {false, true}) {
    Row row;
    row.grow();
    const std::vector<std::uint32_t> end = row.addBranch();
    row.owners.stem[end.front()] = 0;
    for (int k = 0; follows && k < 10; ++k) {
      row.add({0.05F, 0.001F * static_cast<float>(k), 1.9F}, 0);
    }
    row.give();
    EXPECT_EQ(row.owners.of(end.front()), follows ? 1 : 0);
  }
}

}  // namespace
}  // namespace field_phenotyping
