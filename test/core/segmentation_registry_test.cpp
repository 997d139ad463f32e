// One id per plant for as long as the map lasts, reported by one block.

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <thread>
#include <vector>

#include "field_phenotyping/segmentation/plant_registry.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTile = 2.0;

/// A block with plants at the given places of the map; those that it may claim are owned.
SegmentedBlock blockWith(const BlockIndex& index, const std::vector<Eigen::Vector2d>& bases) {
  SegmentedBlock block;
  block.header.index = index;
  block.header.tile_size = kTile;
  block.cloud.origin = {(index.x + 0.5) * kTile, (index.y + 0.5) * kTile, 0.0};
  for (const Eigen::Vector2d& base : bases) {
    Plant plant;
    plant.base.head<2>() = (base - block.cloud.origin.head<2>()).cast<float>();
    plant.owned = block.header.holds(base.x(), base.y(), PlantRegistry::kBorderTolerance);
    block.plants.push_back(plant);
  }
  return block;
}

std::vector<std::int32_t> identify(PlantRegistry& registry, SegmentedBlock block) {
  registry.identify(block);
  std::vector<std::int32_t> ids;
  for (const Plant& plant : block.plants) ids.push_back(plant.owned ? plant.id : -1);
  return ids;
}

TEST(PlantRegistry, IdsAreStableOverRevisions) {
  PlantRegistry registry;
  const auto first = identify(registry, blockWith({0, 0}, {{0.5, 0.5}, {1.0, 0.5}, {1.5, 0.5}}));
  EXPECT_EQ(std::set<std::int32_t>(first.begin(), first.end()).size(), 3U);
  EXPECT_GE(*std::min_element(first.begin(), first.end()), 0);
  // Estimates wander a little; one more plant comes into sight; the order changes.
  const auto second =
      identify(registry, blockWith({0, 0}, {{0.2, 0.5}, {1.02, 0.48}, {0.51, 0.49}, {1.48, 0.53}}));
  EXPECT_EQ(second[1], first[1]);
  EXPECT_EQ(second[2], first[0]);
  EXPECT_EQ(second[3], first[2]);
  EXPECT_EQ(std::count(first.begin(), first.end(), second[0]), 0) << "a new plant, a new id";
  EXPECT_EQ(registry.size(), 4U);
}

TEST(PlantRegistry, FollowsABaseThatWandersFar) {
  PlantRegistry registry;
  const auto first = identify(registry, blockWith({0, 0}, {{0.5, 0.5}}));
  for (int k = 1; k <= 20; ++k) {
    EXPECT_EQ(identify(registry, blockWith({0, 0}, {{0.5 + 0.03 * k, 0.5}})), first);
  }
  EXPECT_EQ(registry.size(), 1U);
}

TEST(PlantRegistry, APlantHiddenForAWhileKeepsItsId) {
  PlantRegistry registry;
  const auto first = identify(registry, blockWith({0, 0}, {{0.5, 0.5}, {1.0, 0.5}}));
  identify(registry, blockWith({0, 0}, {{0.5, 0.5}}));
  const auto third = identify(registry, blockWith({0, 0}, {{0.5, 0.5}, {1.0, 0.5}}));
  EXPECT_EQ(third, first);
}

TEST(PlantRegistry, BorderPlantsAreClaimedOnce) {
  // Each block places the base on its own side of the border, or on the other's.
  for (const double left : {1.98, 2.02}) {
    for (const double right : {1.97, 2.03}) {
      PlantRegistry registry;
      const auto a = identify(registry, blockWith({0, 0}, {{left, 1.0}}));
      const auto b = identify(registry, blockWith({1, 0}, {{right, 1.0}}));
      EXPECT_EQ(registry.size(), 1U);
      EXPECT_EQ((a[0] >= 0 ? 1 : 0) + (b[0] >= 0 ? 1 : 0), 1);
      // The claim holds over revisions.
      EXPECT_EQ(identify(registry, blockWith({1, 0}, {{right, 1.0}})), b);
      EXPECT_EQ(identify(registry, blockWith({0, 0}, {{left, 1.0}})), a);
    }
  }
}

TEST(PlantRegistry, ACornerPlantIsClaimedOnceByFourBlocks) {
  PlantRegistry registry;
  int claims = 0;
  for (int x = 0; x < 2; ++x) {
    for (int y = 0; y < 2; ++y) {
      const Eigen::Vector2d base(2.0 + 0.01 * x, 2.0 - 0.01 * y);
      claims += identify(registry, blockWith({x, y}, {base}))[0] >= 0 ? 1 : 0;
    }
  }
  EXPECT_EQ(claims, 1);
  EXPECT_EQ(registry.size(), 1U);
}

TEST(PlantRegistry, AClaimIsReleasedWhenThePlantIsNoLongerFound) {
  PlantRegistry registry;
  const auto a = identify(registry, blockWith({0, 0}, {{1.98, 1.0}}));
  ASSERT_GE(a[0], 0);
  EXPECT_EQ(identify(registry, blockWith({1, 0}, {{2.01, 1.0}}))[0], -1);
  // Block 0 no longer sees it: its neighbour takes it over, under the same id.
  identify(registry, blockWith({0, 0}, {{0.5, 0.5}}));
  EXPECT_EQ(identify(registry, blockWith({1, 0}, {{2.01, 1.0}})), a);
  EXPECT_EQ(identify(registry, blockWith({0, 0}, {{1.98, 1.0}}))[0], -1);
}

TEST(PlantRegistry, PlantsOfNeighboursAreLeftAlone) {
  PlantRegistry registry;
  SegmentedBlock block = blockWith({0, 0}, {{0.5, 0.5}, {2.4, 0.5}});
  registry.identify(block);
  EXPECT_FALSE(block.plants[1].owned);
  EXPECT_EQ(block.plants[1].id, -1);
  EXPECT_EQ(registry.size(), 1U);
  EXPECT_GE(identify(registry, blockWith({1, 0}, {{2.4, 0.5}}))[0], 0);
}

TEST(PlantRegistry, TwoPlantsOfABlockNeverShareAnId) {
  // Nearer to each other than two estimates of one base may be apart: the block says they are two.
  PlantRegistry registry;
  const auto ids = identify(registry, blockWith({0, 0}, {{0.50, 0.5}, {0.55, 0.5}, {0.60, 0.5}}));
  EXPECT_EQ(std::set<std::int32_t>(ids.begin(), ids.end()).size(), 3U);
  EXPECT_EQ(std::count(ids.begin(), ids.end(), -1), 0) << "a plant was lost";
  EXPECT_EQ(identify(registry, blockWith({0, 0}, {{0.50, 0.5}, {0.55, 0.5}, {0.60, 0.5}})), ids);
}

TEST(PlantRegistry, FarFromTheOrigin) {
  PlantRegistry registry;
  const Eigen::Vector2d far(500000.0, 4500000.0);
  const BlockIndex index{250000, 2250000};
  const auto first = identify(registry, blockWith(index, {far + Eigen::Vector2d(0.5, 0.5),
                                                          far + Eigen::Vector2d(0.6, 0.5)}));
  EXPECT_NE(first[0], first[1]);
  EXPECT_EQ(identify(registry, blockWith(index, {far + Eigen::Vector2d(0.52, 0.5),
                                                 far + Eigen::Vector2d(0.61, 0.5)})),
            first);
}

TEST(PlantRegistry, BlocksFromManyThreads) {
  PlantRegistry registry;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&registry, t] {
      for (int k = 0; k < 50; ++k) {
        SegmentedBlock block =
            blockWith({t, 0}, {{kTile * t + 0.5, 0.5}, {kTile * t + 1.5, 0.5}, {kTile * t, 1.0}});
        registry.identify(block);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(registry.size(), 12U);
}

}  // namespace
}  // namespace field_phenotyping
