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
  float step = 0.005F;  // [m] from point to point, upwards

  static constexpr float kShort = 1.6F;
  static constexpr float kTall = 2.2F;
  static constexpr std::int32_t kPlants = 4;

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
    for (std::int32_t plant = 1; plant < kPlants; ++plant) {
      for (float z = 0.0F; z < kTall; z += step) add(placeOf(plant, z), plant);
    }
  }
  /// A branch of the tall plant that ends right above the short one; its end is held by that.
  std::vector<std::uint32_t> addBranch() {
    std::vector<std::uint32_t> end;
    for (float x = 0.2F; x >= 0.0F; x -= step) {
      const bool is_held = x < 0.04F;
      const std::uint32_t i = add({x, 0.0F, 1.9F}, is_held ? 0 : 1);
      if (is_held) end.push_back(i);
    }
    return end;
  }
  std::vector<float> give() {
    const NeighborGrid grid(block.cloud.points, 0.025F);
    return giveDetachedTops(block, grid, static_cast<std::size_t>(kPlants), owners, isolated);
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

TEST(DetachedTops, StayWhereFewPointsWereToBeExpectedBelow) {
  Row row;
  row.step = 0.08F;
  row.grow();
  row.step = 0.01F;
  const std::vector<std::uint32_t> end = row.addBranch();
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 0);
}

TEST(DetachedTops, StayWherePlantsUsuallyHaveSuchGaps) {
  Row row;
  row.grow();
  for (std::int32_t plant = 1; plant < Row::kPlants; ++plant) {
    row.add(Row::placeOf(plant, Row::kTall + 0.3F), plant);
  }
  const std::vector<std::uint32_t> end = row.addBranch();
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 0);
}

TEST(DetachedTops, StayWhereOthersHaveSuchGapsWithNoPlantNear) {
  Row row;
  row.grow();
  row.add(Row::placeOf(3, Row::kTall + 0.3F), 3);
  const std::vector<std::uint32_t> end = row.addBranch();
  row.give();
  for (const std::uint32_t i : end) EXPECT_EQ(row.owners.plant[i], 0);
}

TEST(DetachedTops, PointsTakenForOutliersBridgeGapsAndMayBeGiven) {
  Row row;
  row.grow();
  const std::vector<std::uint32_t> end = row.addBranch();
  const std::uint32_t lone = row.addIsolated({0.0F, 0.02F, 1.91F}, 0);
  for (float z = Row::kShort; z < 1.9F; z += 0.05F) row.addIsolated({0.0F, 0.0F, z}, 0);
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
