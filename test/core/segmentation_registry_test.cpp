// One id per plant for as long as the map lasts, reported by one block.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <thread>
#include <vector>

#include "field_phenotyping/segmentation/plant_registry.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTile = 2.0;

/// A block with plants at the given places of the map; those that it may claim are owned.
SegmentedBlock blockWith(const BlockIndex& index, const std::vector<Eigen::Vector2d>& bases,
                         double tile = kTile) {
  SegmentedBlock block;
  block.header.index = index;
  block.header.tile_size = tile;
  block.cloud.origin = {(index.x + 0.5) * tile, (index.y + 0.5) * tile, 0.0};
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

/// A draft of a part of the tile, from `low` to `high`.
SegmentedBlock partWith(const BlockIndex& index, const Eigen::Vector2d& low,
                        const Eigen::Vector2d& high, const std::vector<Eigen::Vector2d>& bases) {
  SegmentedBlock block = blockWith(index, bases);
  block.header.part = {low, high};
  for (std::size_t p = 0; p < bases.size(); ++p) {
    block.plants[p].owned =
        block.header.holds(bases[p].x(), bases[p].y(), PlantRegistry::kBorderTolerance);
  }
  return block;
}

TEST(PlantRegistry, ADraftOfAPartLeavesTheTilesOtherPlantsToTheBlock) {
  PlantRegistry registry;
  // The last one is claimed across the border; the neighbour sees it and the first one's row.
  const auto first =
      identify(registry, blockWith({0, 0}, {{0.5, 0.5}, {0.95, 0.5}, {1.5, 0.5}, {2.05, 0.5}}));
  // Of those in the part one is found, one is not, and one is new; a margin's plant is not its own.
  const auto part = identify(
      registry, partWith({0, 0}, {1.0, 0.0}, {2.0, 1.0}, {{0.5, 0.5}, {1.51, 0.5}, {1.2, 0.8}}));
  EXPECT_EQ(part[0], -1);
  EXPECT_EQ(part[1], first[2]);
  EXPECT_EQ(std::count(first.begin(), first.end(), part[2]), 0);
  // What it has said nothing of is still claimed, what it could not find is free.
  const auto beside = identify(registry, blockWith({1, 0}, {{2.05, 0.5}, {2.5, 0.5}}));
  EXPECT_EQ(beside[0], -1) << "stands beside the part: still the other block's";
  const auto left = identify(registry, blockWith({-1, 0}, {{-0.05, 0.5}}));
  EXPECT_GE(left[0], 0);
  const auto all = identify(
      registry, blockWith({0, 0}, {{0.5, 0.5}, {0.95, 0.5}, {1.5, 0.5}, {2.05, 0.5}, {1.2, 0.8}}));
  EXPECT_EQ(all[0], first[0]);
  EXPECT_EQ(all[1], first[1]);
  EXPECT_EQ(all[2], first[2]);
  EXPECT_EQ(all[3], first[3]);
  EXPECT_EQ(all[4], part[2]);
}

TEST(PlantRegistry, APlantThatWandersOverThePartsBorderKeepsItsId) {
  for (const double before : {0.98, 1.02}) {
    for (const double now : {0.97, 1.03}) {
      PlantRegistry registry;
      const auto first = identify(registry, blockWith({0, 0}, {{before, 0.5}, {1.5, 0.5}}));
      const auto part =
          identify(registry, partWith({0, 0}, {1.0, 0.0}, {2.0, 2.0}, {{now, 0.5}, {1.5, 0.5}}));
      EXPECT_TRUE(part[0] == first[0] || part[0] == -1) << before << " " << now;
      EXPECT_EQ(identify(registry, blockWith({0, 0}, {{now, 0.5}, {1.5, 0.5}})), first);
      EXPECT_EQ(registry.size(), 2U);
    }
  }
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

TEST(PlantRegistry, TwoIdsOfOnePlantBecomeOne) {
  // At first two blocks place it 9 cm apart, each on its own side of the border; then they come
  // together. Whichever speaks next or last, one id stays.
  for (const bool left_first : {true, false}) {
    for (const bool final : {true, false}) {
      PlantRegistry registry;
      const Eigen::Vector2d left_early(1.955, 1.0), right_early(2.045, 1.0);
      const Eigen::Vector2d left_late(1.99, 1.0), right_late(2.01, 1.0);
      std::set<std::int32_t> ids;
      const auto say = [&](int x, const Eigen::Vector2d& base, bool last) {
        SegmentedBlock block = blockWith({x, 0}, {base});
        block.header.final = last;
        registry.identify(block);
        return block.plants[0].owned ? block.plants[0].id : -1;
      };
      const std::int32_t left = say(0, left_early, false);
      const std::int32_t right = say(1, right_early, false);
      ASSERT_NE(left, right);
      ASSERT_GE(std::min(left, right), 0);
      std::int32_t last_left = -1, last_right = -1;
      for (int k = 0; k < 2; ++k) {
        if (left_first) last_left = say(0, left_late, final);
        last_right = say(1, right_late, final);
        if (!left_first) last_left = say(0, left_late, final);
      }
      EXPECT_EQ((last_left >= 0 ? 1 : 0) + (last_right >= 0 ? 1 : 0), 1)
          << last_left << " and " << last_right;
      EXPECT_EQ(std::max(last_left, last_right), left) << "the older id";
      EXPECT_EQ(registry.size(), 1U);
    }
  }
}

TEST(PlantRegistry, NeighboursTenCentimetresApartOnABorderStayTwo) {
  // Both blocks see both of them, 5.5 cm apart at worst; none is given up.
  for (unsigned seed = 0U; seed < 50U; ++seed) {
    PlantRegistry registry;
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> error(-0.02, 0.02);
    const Eigen::Vector2d one(1.95, 1.0), other(2.05, 1.0);
    std::vector<std::set<std::int32_t>> ids(2U);
    for (int k = 0; k < 6; ++k) {
      SegmentedBlock block =
          blockWith({k % 2, 0}, {one + Eigen::Vector2d(error(random), error(random)),
                                 other + Eigen::Vector2d(error(random), error(random))});
      block.header.final = k >= 4;
      registry.identify(block);
      for (std::size_t p = 0; p < 2U; ++p) {
        if (block.plants[p].owned) ids[p].insert(block.plants[p].id);
      }
    }
    EXPECT_EQ(ids[0].size(), 1U) << "seed " << seed;
    EXPECT_EQ(ids[1].size(), 1U) << "seed " << seed;
    EXPECT_NE(*ids[0].begin(), *ids[1].begin());
    EXPECT_EQ(registry.size(), 2U);
  }
}

TEST(PlantRegistry, PlantsNamedBeforeTheShiftIsKnownGetTheirOlderIds) {
  // The map has moved by 10 cm, and the first revision of the second pass sees but three plants.
  constexpr std::uint64_t kSecond = 1'000'000'000U;
  std::mt19937 random(3U);
  std::normal_distribution<double> sown(0.0, 0.015);
  std::vector<Eigen::Vector2d> bases, moved;
  for (int k = 0; k < 9; ++k) {
    bases.emplace_back(0.1 + 0.2 * k + sown(random), 1.0 + sown(random));
    moved.emplace_back(bases.back() + Eigen::Vector2d(0.06, 0.08) +
                       0.2 * Eigen::Vector2d(sown(random), sown(random)));
  }
  PlantRegistry registry;
  SegmentedBlock first = blockWith({0, 0}, bases);
  first.header.began_ns = 10U * kSecond;
  first.header.stamp_ns = 20U * kSecond;
  first.header.final = true;
  registry.identify(first);
  for (const std::size_t seen : {std::size_t{3}, bases.size()}) {
    SegmentedBlock second =
        blockWith({0, 0}, {moved.begin(), moved.begin() + static_cast<int>(seen)});
    second.header.began_ns = 100U * kSecond;
    second.header.stamp_ns = (100U + seen) * kSecond;
    registry.identify(second);
    if (seen < bases.size()) continue;
    for (std::size_t k = 0; k < seen; ++k) EXPECT_EQ(second.plants[k].id, first.plants[k].id);
  }
  EXPECT_EQ(registry.size(), bases.size());
}

/// Nine plants along x, the first of which stands at `from`.
std::vector<Eigen::Vector2d> rowFrom(double from) {
  std::mt19937 random(4U);
  std::normal_distribution<double> sown(0.0, 0.015);
  std::vector<Eigen::Vector2d> bases;
  for (int k = 0; k < 9; ++k) {
    bases.emplace_back((k == 0 ? from : 0.2 * k) + sown(random), 1.0 + sown(random));
  }
  return bases;
}

/// The map has moved by 10 cm, and a block at the end of the row sees but its last plant: too few
/// to know it. Its neighbour sees enough.
/// @param from where the row begins; the neighbour's tile begins at 0
void passTheEndOfARow(double from) {
  SCOPED_TRACE(from);
  constexpr std::uint64_t kSecond = 1'000'000'000U;
  const std::vector<Eigen::Vector2d> bases = rowFrom(from);
  std::vector<Eigen::Vector2d> moved;
  for (const Eigen::Vector2d& base : bases) moved.emplace_back(base + Eigen::Vector2d(0.04, 0.09));
  PlantRegistry registry;
  const auto pass = [&](const BlockIndex& index, const std::vector<Eigen::Vector2d>& seen,
                        std::uint64_t began, std::uint64_t stamp) {
    SegmentedBlock block = blockWith(index, seen);
    block.header.began_ns = began * kSecond;
    block.header.stamp_ns = stamp * kSecond;
    return identify(registry, block);
  };
  const auto ends = [](const std::vector<Eigen::Vector2d>& all) {
    return std::vector<Eigen::Vector2d>{all.begin(), all.begin() + 2};
  };
  const auto together = [](std::vector<std::int32_t> ids, const std::vector<std::int32_t>& more) {
    ids.insert(ids.end(), more.begin(), more.end());
    ids.erase(std::remove(ids.begin(), ids.end(), -1), ids.end());
    std::sort(ids.begin(), ids.end());
    return ids;
  };
  const auto last = pass({-1, 0}, ends(bases), 1U, 20U);
  const auto all = together(last, pass({0, 0}, bases, 2U, 21U));
  ASSERT_EQ(all.size(), bases.size());
  EXPECT_NE(pass({-1, 0}, ends(moved), 100U, 105U), last) << "nobody could know";
  const auto others = pass({0, 0}, moved, 101U, 110U);
  EXPECT_EQ(together(others, pass({-1, 0}, ends(moved), 100U, 115U)), all);
  // That block is left and seen again: the map has not moved since.
  const auto again = pass({-1, 0}, ends(moved), 130U, 133U);
  EXPECT_EQ(together(again, pass({0, 0}, moved, 132U, 140U)), all);
  EXPECT_EQ(registry.size(), bases.size());
}

TEST(PlantRegistry, PlantsThatAnotherBlockNamedInDoubtGetTheirOlderIdsToo) {
  for (const double from : {-0.20, -0.10, -0.04, 0.0}) passTheEndOfARow(from);
}

/// The same, but the block at the end speaks for the last time before its neighbour is seen.
/// @param off between where the two blocks see the plant, along the row [m]
/// @param left_again whether it is seen once more in between, in a pass of its own
void passTheEndOfARowForTheLastTime(double from, double off, bool left_again) {
  SCOPED_TRACE(::testing::Message() << from << ", " << off << " m off");
  constexpr std::uint64_t kSecond = 1'000'000'000U;
  const std::vector<Eigen::Vector2d> bases = rowFrom(from);
  std::vector<Eigen::Vector2d> moved;
  for (const Eigen::Vector2d& base : bases) moved.emplace_back(base + Eigen::Vector2d(0.04, 0.09));
  PlantRegistry registry;
  std::map<BlockIndex, std::vector<std::int32_t>> said;  // what counts of each block
  const auto pass = [&](const BlockIndex& index, const std::vector<Eigen::Vector2d>& seen,
                        std::uint64_t began, std::uint64_t stamp) {
    SegmentedBlock block = blockWith(index, seen);
    block.header.began_ns = began * kSecond;
    block.header.stamp_ns = stamp * kSecond;
    block.header.final = true;
    const PlantRegistry::Outcome outcome = registry.identify(block);
    said[index].clear();
    for (const Plant& plant : block.plants) {
      if (plant.owned) said[index].push_back(plant.id);
    }
    for (const PlantRegistry::TakenBack& back : outcome.taken_back) {
      for (auto& [block_index, ids] : said) {
        const auto wrong = std::find(ids.begin(), ids.end(), back.id);
        if (wrong == ids.end()) continue;
        if (back.older >= 0) {
          *wrong = back.older;
        } else {
          ids.erase(wrong);
        }
      }
    }
  };
  const auto all = [&] {
    std::vector<std::int32_t> ids;
    for (const auto& block : said) ids.insert(ids.end(), block.second.begin(), block.second.end());
    std::sort(ids.begin(), ids.end());
    return ids;
  };
  const auto last = [](const std::vector<Eigen::Vector2d>& row) {
    return std::vector<Eigen::Vector2d>{row.front()};
  };
  pass({-1, 0}, last(bases), 1U, 20U);
  pass({0, 0}, bases, 2U, 21U);
  const std::vector<std::int32_t> first = all();
  ASSERT_EQ(first.size(), bases.size());
  pass({-1, 0}, last(moved), 100U, 105U);
  const std::vector<std::int32_t> in_doubt = said.at({-1, 0});
  if (left_again) {
    pass({-1, 0}, {}, 107U, 108U);  // hardly: it has been forgotten meanwhile
    said.at({-1, 0}) = in_doubt;
  }
  moved.front().x() += off;
  pass({0, 0}, moved, 101U, 110U);
  std::vector<std::int32_t> now = all();
  // What it said in the pass before stays, of the plant itself.
  if (left_again) now.erase(std::unique(now.begin(), now.end()), now.end());
  EXPECT_EQ(now, first);
  EXPECT_EQ(registry.size(), bases.size());
}

TEST(PlantRegistry, AnIdGivenInDoubtIsTakenBackAfterTheLastReportToo) {
  for (const double from : {-0.20, -0.10, -0.04}) {
    for (const double off : {-0.03, 0.0, 0.03}) {
      for (const bool left_again : {false, true}) {
        passTheEndOfARowForTheLastTime(from, off, left_again);
      }
    }
  }
}

TEST(PlantRegistry, SaysHowManyIdsMayBeTakenBack) {
  PlantRegistry registry;
  SegmentedBlock first = blockWith({0, 0}, {{0.5, 0.5}, {1.5, 0.5}});
  first.header.stamp_ns = 5U;
  EXPECT_EQ(registry.identify(first).provisional, 0U);
  SegmentedBlock second = blockWith({0, 0}, {{0.6, 0.5}, {1.0, 0.5}});
  second.header.began_ns = 6U;
  second.header.stamp_ns = 7U;
  EXPECT_EQ(registry.identify(second).provisional, 1U) << "there is an older one 10 cm from it";
}

TEST(PlantRegistry, TheLastReportOfTheTileItselfTakesAPlantFromABlockThatIsStillOpen) {
  PlantRegistry registry;
  SegmentedBlock open = blockWith({0, 0}, {{2.03, 1.0}});
  registry.identify(open);
  ASSERT_TRUE(open.plants[0].owned);
  SegmentedBlock tile = blockWith({1, 0}, {{2.03, 1.0}});
  registry.identify(tile);
  EXPECT_FALSE(tile.plants[0].owned) << "there is time";
  tile = blockWith({1, 0}, {{2.03, 1.0}});
  tile.header.final = true;
  registry.identify(tile);
  EXPECT_TRUE(tile.plants[0].owned) << "the other might not see it at last";
  EXPECT_EQ(tile.plants[0].id, open.plants[0].id);
  const std::int32_t id = open.plants[0].id;
  open = blockWith({0, 0}, {{2.03, 1.0}});
  open.header.final = true;
  registry.identify(open);
  EXPECT_FALSE(open.plants[0].owned);
  EXPECT_EQ(registry.size(), 1U);
  EXPECT_GE(id, 0);
}

TEST(PlantRegistry, AReportedPlantThatWandersOutOfReachStaysTheBlocks) {
  PlantRegistry registry;
  const auto report = [&](int x, double at, bool final) {
    SegmentedBlock block = blockWith({x, 0}, {{at, 1.0}, {2.3, 1.0}});
    block.header.final = final;
    return identify(registry, block)[0];
  };
  const std::int32_t id = report(0, 2.095, true);
  ASSERT_GE(id, 0);
  EXPECT_EQ(report(1, 2.10, true), -1);
  EXPECT_EQ(report(0, 2.105, true), id) << "nobody else will report it";
  EXPECT_EQ(report(0, 2.18, true), -1) << "this is another one's";
}

TEST(PlantRegistry, HiddenPlantsMoveOnceThoughManyBlocksSeeThemIn) {
  // Two neighbours are seen a second time in a moved map, the right one a little later; each knows
  // of the other's plants near the border.
  constexpr std::uint64_t kSecond = 1'000'000'000U;
  std::mt19937 random(5U);
  std::normal_distribution<double> sown(0.0, 0.015);
  for (const std::uint64_t later : {1U, 200U}) {
    std::vector<Eigen::Vector2d> left, right, seen_left, seen_right;
    for (int k = 0; k < 20; ++k) {
      const Eigen::Vector2d base(0.1 + 0.2 * k + sown(random), 1.0 + sown(random));
      (base.x() < kTile ? left : right).push_back(base);
    }
    PlantRegistry registry;
    const auto pass = [&](int x, std::vector<Eigen::Vector2d> all, std::uint64_t began,
                          std::uint64_t stamp, bool final) {
      SegmentedBlock block = blockWith({x, 0}, all);
      block.header.began_ns = began * kSecond;
      block.header.stamp_ns = stamp * kSecond;
      block.header.final = final;
      return identify(registry, block);
    };
    const auto with = [](std::vector<Eigen::Vector2d> own, const Eigen::Vector2d& neighbour) {
      own.push_back(neighbour);
      return own;
    };
    const auto moved = [](std::vector<Eigen::Vector2d> all) {
      for (Eigen::Vector2d& base : all) base += Eigen::Vector2d(-0.03, 0.09);
      return all;
    };
    const auto first = pass(0, left, 1U, 50U, true);
    const auto second = pass(1, right, 1U, 50U, true);
    // In the margin of the left block, beyond its border.
    const std::uint64_t end = 100U + (later > 100U ? 50U : 400U);
    EXPECT_EQ(pass(0, moved(with(left, right[2])), 100U, end, true)[3], first[3]);
    EXPECT_EQ(pass(1, moved(right), 100U + later, 500U, true), second) << "began " << later;
    EXPECT_EQ(registry.size(), left.size() + right.size());
  }
}

TEST(PlantRegistry, AClaimLapsesLongAfterItsBlockWasSeen) {
  constexpr std::uint64_t kThen = 5'000'000'000U;
  PlantRegistry registry;
  SegmentedBlock left = blockWith({0, 0}, {{1.98, 1.0}});
  left.header.stamp_ns = kThen;
  registry.identify(left);
  ASSERT_GE(left.plants[0].id, 0);
  SegmentedBlock soon = blockWith({1, 0}, {{2.01, 1.0}});
  soon.header.stamp_ns = kThen + PlantRegistry::kClaimHolds;
  registry.identify(soon);
  EXPECT_FALSE(soon.plants[0].owned);
  SegmentedBlock late = blockWith({1, 0}, {{2.01, 1.0}});
  late.header.stamp_ns = kThen + PlantRegistry::kClaimHolds + 1U;
  registry.identify(late);
  EXPECT_TRUE(late.plants[0].owned);
  EXPECT_EQ(late.plants[0].id, left.plants[0].id);
}

/// @param border where a plant stands at first that the left block has claimed [m]
void carryOverTheBorder(bool right_first, double border) {
  SCOPED_TRACE(::testing::Message() << border << (right_first ? ", right" : ", left") << " first");
  PlantRegistry registry;
  const auto report = [&](int x, double moved, std::uint64_t began, std::uint64_t end) {
    std::vector<Eigen::Vector2d> bases;
    for (const double at : {1.0, 1.23, 1.37, 1.62, 1.79, border, 2.21, 2.36, 2.63, 2.81}) {
      bases.emplace_back(at + moved, 1.0);
    }
    SegmentedBlock block = blockWith({x, 0}, bases);
    block.header.began_ns = began;
    block.header.stamp_ns = end;
    block.header.final = true;
    return identify(registry, block);
  };
  const auto first = report(0, 0.0, 1U, 10U);
  report(1, 0.0, 1U, 10U);
  ASSERT_GE(first[5], 0);
  std::map<int, std::vector<std::int32_t>> second;
  for (const int x : right_first ? std::vector<int>{1, 0} : std::vector<int>{0, 1}) {
    second[x] = report(x, 0.13, 100U, 110U);
  }
  EXPECT_EQ(second[1][5], first[5]);
  EXPECT_EQ(second[0][5], -1);
  EXPECT_EQ(registry.size(), 10U);
}

TEST(PlantRegistry, APlantThatTheMapCarriesOverTheBorderIsTheOtherBlocks) {
  // Whichever of the two blocks reports first in the second pass, and on whichever side of the
  // border the plant stood that the left one has claimed.
  for (const bool right_first : {true, false}) {
    for (const double border : {1.98, 2.03}) carryOverTheBorder(right_first, border);
  }
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

/// Rows of plants with sowing errors, in tiles.
class Stand {
 public:
  static constexpr double kBlock = 4.0;  // [m]

  Stand(int rows, int plants_per_row, double row_spacing, double spacing, unsigned seed)
      : random_(seed) {
    for (int r = 0; r < rows; ++r) {
      for (int k = 0; k < plants_per_row; ++k) {
        bases_.emplace_back(spacing * k + 0.08 * spacing * normal_(random_),
                            row_spacing * r + 0.01 * normal_(random_));
      }
    }
  }

  std::size_t size() const { return bases_.size(); }

  /// One pass over all tiles: each plant is seen with probability `seen`, `error` off, in a map
  /// that has moved. Adds the ids that plant k was given to `ids[k]`.
  void pass(PlantRegistry& registry, std::uint64_t begin_ns, const Eigen::Vector2d& shift,
            double error, double seen, std::vector<std::set<std::int32_t>>& ids) {
    constexpr std::uint64_t kSecond = 1'000'000'000U;
    std::map<BlockIndex, std::vector<std::pair<std::size_t, Eigen::Vector2d>>> tiles;
    for (std::size_t k = 0; k < bases_.size(); ++k) {
      if (!(uniform_(random_) < seen)) continue;
      const Eigen::Vector2d base =
          bases_[k] + shift + error * Eigen::Vector2d(normal_(random_), normal_(random_));
      for (int x = -1; x <= 1; ++x) {
        for (int y = -1; y <= 1; ++y) {
          const BlockIndex index{static_cast<int>(std::floor(base.x() / kBlock)) + x,
                                 static_cast<int>(std::floor(base.y() / kBlock)) + y};
          tiles[index].emplace_back(k, base);  // with the neighbours', as margins have them
        }
      }
    }
    std::uint64_t stamp = begin_ns + kSecond;
    for (auto& [index, plants] : tiles) {
      // First what was seen so far, then all.
      for (const std::size_t count : {plants.size() / 3U, plants.size()}) {
        std::vector<Eigen::Vector2d> bases;
        for (std::size_t k = 0; k < count; ++k) bases.push_back(plants[k].second);
        SegmentedBlock block = blockWith(index, bases, kBlock);
        block.header.began_ns = begin_ns;
        block.header.final = count == plants.size();
        block.header.stamp_ns = stamp += kSecond;
        registry.identify(block);
        for (std::size_t k = 0; k < count; ++k) {
          if (block.plants[k].owned) ids[plants[k].first].insert(block.plants[k].id);
        }
      }
    }
  }

 private:
  std::mt19937 random_;
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> uniform_{0.0, 1.0};
  std::vector<Eigen::Vector2d> bases_;
};

void expectOneIdEach(const std::vector<std::set<std::int32_t>>& ids, std::size_t registered) {
  std::set<std::int32_t> all;
  std::size_t several = 0U;
  for (const auto& of_plant : ids) {
    several += of_plant.size() > 1U ? 1U : 0U;
    all.insert(of_plant.begin(), of_plant.end());
  }
  EXPECT_EQ(several, 0U) << "plants have several ids";
  EXPECT_EQ(all.size(), ids.size()) << "plants share an id";
  EXPECT_EQ(registered, ids.size()) << "plants are registered twice";
}

TEST(PlantRegistry, ASecondPassFindsEveryPlantAgain) {
  constexpr std::uint64_t kMinutes = 60'000'000'000U;
  for (const double spacing : {0.20, 0.15, 0.10}) {
    for (unsigned seed = 0; seed < 8U; ++seed) {
      // A SLAM that has moved the map by up to 10 cm, in any direction, and moves it back again.
      std::mt19937 random(seed);
      std::uniform_real_distribution<double> turn(0.0, 6.283);
      const double direction = turn(random);
      const Eigen::Vector2d shift =
          (0.0125 * (seed + 1U)) * Eigen::Vector2d(std::cos(direction), std::sin(direction));
      SCOPED_TRACE(::testing::Message() << "spacing " << spacing << " shift " << shift.transpose());
      PlantRegistry registry(0.4 * spacing < 0.06 ? 0.4 * spacing : 0.06);
      Stand stand(7, static_cast<int>(15.0 / spacing), 0.75, spacing, seed);
      std::vector<std::set<std::int32_t>> ids(stand.size());
      stand.pass(registry, 1U * kMinutes, Eigen::Vector2d::Zero(), 0.003, 1.0, ids);
      stand.pass(registry, 10U * kMinutes, shift, 0.006, 0.9, ids);
      stand.pass(registry, 20U * kMinutes, shift, 0.006, 0.9, ids);
      stand.pass(registry, 30U * kMinutes, Eigen::Vector2d::Zero(), 0.006, 0.9, ids);
      expectOneIdEach(ids, registry.size());
    }
  }
}

TEST(PlantRegistry, APlantThatWasAddedIsNoReasonToThinkThatTheMapMoved) {
  PlantRegistry registry;
  SegmentedBlock first = blockWith({0, 0}, {{0.5, 0.5}, {0.7, 0.5}});
  first.header.stamp_ns = 5U;
  registry.identify(first);
  SegmentedBlock second = blockWith({0, 0}, {{0.4, 0.5}, {0.5, 0.5}, {0.7, 0.5}});
  second.header.began_ns = 6U;
  second.header.stamp_ns = 7U;
  const PlantRegistry::Outcome outcome = registry.identify(second);
  EXPECT_EQ(outcome.known, 2U);
  EXPECT_EQ(outcome.added, 1U);
  EXPECT_EQ(second.plants[1].id, first.plants[0].id);
  EXPECT_EQ(outcome.shift.norm(), 0.0);
}

TEST(PlantRegistry, GoesOnWithThePlantsOfAnEarlierRun) {
  PlantRegistry registry;
  registry.restore({{17, {0.5, 0.5}, 3U}, {4, {1.0, 0.5}, 3U}});
  SegmentedBlock block = blockWith({0, 0}, {{1.01, 0.5}, {0.2, 0.5}, {0.5, 0.49}});
  block.header.began_ns = 8U;
  block.header.stamp_ns = 9U;
  registry.identify(block);
  EXPECT_EQ(block.plants[0].id, 4);
  EXPECT_EQ(block.plants[1].id, 18) << "new ids begin above the old ones";
  EXPECT_EQ(block.plants[2].id, 17);
}

TEST(PlantRegistry, OfAnEarlierRunIdsOfOnePlantAreOne) {
  PlantRegistry registry;
  registry.restore({{9, {0.52, 0.5}, 7U, false}, {4, {0.5, 0.5}, 5U}, {6, {1.5, 0.5}, 5U, false}});
  EXPECT_EQ(registry.size(), 2U) << "9 was taken back; 6 was only not seen any more";
  SegmentedBlock block = blockWith({0, 0}, {{0.52, 0.5}, {1.5, 0.5}, {0.2, 0.2}});
  block.header.began_ns = 8U;
  block.header.stamp_ns = 9U;
  registry.identify(block);
  EXPECT_EQ(block.plants[0].id, 4);
  EXPECT_EQ(block.plants[1].id, 6);
  EXPECT_EQ(block.plants[2].id, 10) << "an id that was taken back is not given again";
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
