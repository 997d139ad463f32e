#include "plant_table.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "first_values.hpp"

namespace field_phenotyping {
namespace {

constexpr std::uint64_t kSecond = 1'000'000'000U;

Phenotype plant(std::int32_t id, double height, double stddev = 0.01) {
  Phenotype result;
  result.id = id;
  result.height = {height, stddev};
  result.base = {0.1 * id, 0.0, 0.0};
  return result;
}

/// Of a block that was first seen `began` seconds after the start, and last at `stamp`.
ReportSource source(const BlockIndex& block, std::uint32_t revision, std::uint64_t began = 1U,
                    std::uint64_t stamp = 2U) {
  ReportSource result;
  result.block = block;
  result.revision = revision;
  result.began_ns = began * kSecond;
  result.stamp_ns = stamp * kSecond;
  return result;
}

TEST(PlantTable, KeepsTheNewestRevision) {
  PlantTable table;
  const auto first = table.update(source({0, 0}, 1U), {plant(3, 1.0), plant(1, 2.0)});
  EXPECT_TRUE(first.accepted);
  EXPECT_EQ(first.added.size(), 2U);
  const auto second = table.update(source({0, 0}, 2U), {plant(3, 1.5), plant(1, 2.0)});
  EXPECT_TRUE(second.removed.empty());
  EXPECT_TRUE(second.added.empty());
  ASSERT_EQ(table.size(), 2U);
  EXPECT_EQ(table.plants()[0].id, 1);
  EXPECT_EQ(table.plants()[1].height.value, 1.5);
  EXPECT_EQ(table.plants()[1].passes, 1U);
}

TEST(FirstValues, APlantThatComesBackHasHadThem) {
  PlantTable table;
  FirstValues first;
  const auto report = [&](std::uint32_t revision, const std::vector<Phenotype>& plants) {
    return first.countIn(table.update(source({0, 0}, revision), plants));
  };
  EXPECT_EQ(report(1U, {plant(1, 1.0), plant(2, 1.0)}), 2U);
  EXPECT_EQ(report(2U, {plant(1, 1.0)}), 0U) << "a revision does not see the other";
  EXPECT_EQ(report(3U, {plant(1, 1.0), plant(2, 1.0), plant(3, 1.0)}), 1U);
}

TEST(FirstValues, RemembersTheLastThatWent) {
  FirstValues first;
  PlantTable::Change gone;
  for (std::size_t k = 0; k <= FirstValues::kMostWithdrawn; ++k) {
    gone.removed.push_back(static_cast<std::int32_t>(k));
  }
  EXPECT_EQ(first.countIn(gone), 0U);
  PlantTable::Change back;
  back.added = {0, 1};
  EXPECT_EQ(first.countIn(back), 1U) << "the one that went first is forgotten";
}

TEST(PlantTable, TakesTheSameRevisionAgain) {
  PlantTable table;
  table.update(source({0, 0}, 2U), {plant(1, 1.0)});
  EXPECT_TRUE(table.update(source({0, 0}, 2U), {plant(1, 1.2)}).accepted)
      << "after a parameter changed";
  EXPECT_EQ(table.plants()[0].height.value, 1.2);
}

TEST(PlantTable, KeepsMeasuredPlantsWhenRevisionsStartAgain) {
  PlantTable table;
  table.update(source({0, 0}, 5U), {plant(1, 1.0)});
  EXPECT_FALSE(table.update(source({0, 0}, 1U), {}).accepted);
  EXPECT_EQ(table.size(), 1U);
}

TEST(PlantTable, ForgetsPlantsThatAreNoLongerFound) {
  PlantTable table;
  table.update(source({0, 0}, 1U), {plant(1, 1.0), plant(2, 1.0)});
  table.update(source({1, 0}, 1U), {plant(3, 1.0)});
  EXPECT_EQ(table.update(source({0, 0}, 2U), {plant(2, 1.0)}).removed,
            std::vector<std::int32_t>{1});
  EXPECT_EQ(table.size(), 2U);
  ASSERT_EQ(table.plantsOf({0, 0}).size(), 1U);
  EXPECT_EQ(table.plantsOf({0, 0})[0].id, 2);
}

TEST(PlantTable, CountsAPlantThatChangesItsBlockOnce) {
  PlantTable table;
  table.update(source({0, 0}, 1U), {plant(1, 1.0)});
  table.update(source({1, 0}, 1U), {plant(1, 1.1)});
  EXPECT_TRUE(table.update(source({0, 0}, 2U), {}).removed.empty()) << "the neighbour reports it";
  ASSERT_EQ(table.size(), 1U);
  EXPECT_EQ(table.plants()[0].height.value, 1.1);
  EXPECT_EQ(table.plants()[0].passes, 1U) << "two blocks that were seen at one time are one pass";
  EXPECT_TRUE(table.plantsOf({0, 0}).empty());
}

TEST(PlantTable, WhatADraftOfAPartSaysNothingOfStaysAsItWas) {
  PlantTable table;
  const auto header = [](std::uint32_t revision, std::uint64_t began, std::uint64_t stamp) {
    BlockHeader draft;
    draft.revision = revision;
    draft.began_ns = began * kSecond;
    draft.stamp_ns = stamp * kSecond;
    draft.part = {Eigen::Vector2d(0.25, -1.0), Eigen::Vector2d(4.0, 4.0)};
    return draft;
  };
  const auto report = [&](const BlockHeader& draft, const std::vector<Phenotype>& plants) {
    return table.update(ReportSource(draft), table.withUntouched(draft, plants));
  };
  table.update(source({0, 0}, 1U), {plant(1, 1.0), plant(2, 1.0), plant(3, 1.0), plant(4, 1.0)});
  table.update(source({1, 0}, 1U), {plant(2, 1.1)});
  const auto change = report(header(2U, 1U, 3U), {plant(3, 1.5), plant(5, 1.0)});
  EXPECT_EQ(change.added, std::vector<std::int32_t>{5});
  EXPECT_EQ(change.removed, std::vector<std::int32_t>{4}) << "in the part, and not found again";
  ASSERT_EQ(table.plantsOf({0, 0}).size(), 3U);
  EXPECT_EQ(table.plantsOf({0, 0})[0].id, 1) << "beside the part";
  EXPECT_EQ(table.plantsOf({0, 0})[1].height.value, 1.5);
  EXPECT_EQ(table.plantsOf({1, 0})[0].height.value, 1.1) << "a neighbour's by now";
  // Of another pass it says nothing.
  EXPECT_EQ(table.withUntouched(header(1U, 400U, 410U), {}).size(), 0U);
  // Nor has a block of the whole tile anything untouched.
  BlockHeader whole = header(3U, 1U, 4U);
  whole.part.setEmpty();
  EXPECT_EQ(table.withUntouched(whole, {}).size(), 0U);
}

TEST(PlantTable, FusesPasses) {
  PlantTable table;
  table.update(source({0, 0}, 1U, 10U, 20U), {plant(1, 1.00), plant(2, 1.0)});
  table.update(source({0, 0}, 1U, 400U, 410U), {plant(1, 1.01)});
  ASSERT_EQ(table.size(), 2U) << "hidden in one pass, believed in from the other";
  const Phenotype fused = table.plants()[0];
  EXPECT_EQ(fused.passes, 2U);
  EXPECT_NEAR(fused.height.value, 1.005, 1e-9);
  EXPECT_NEAR(fused.height.stddev, 0.01 / std::sqrt(2.0), 1e-9);
  // A newer revision of the second pass replaces what that pass has said, and nothing else.
  table.update(source({0, 0}, 2U, 400U, 420U), {plant(1, 1.02, 0.005)});
  EXPECT_EQ(table.plants()[0].passes, 2U);
  EXPECT_NEAR(table.plants()[0].height.value, (1.0 + 4.0 * 1.02) / 5.0, 1e-9);
  // Not found after all: the first pass still stands.
  EXPECT_TRUE(table.update(source({0, 0}, 3U, 400U, 430U), {}).removed.empty());
  EXPECT_EQ(table.plants()[0].height.value, 1.0);
}

TEST(PlantTable, ABagThatIsPlayedAgainAddsNothing) {
  PlantTable table;
  for (int loop = 0; loop < 3; ++loop) {
    table.update(source({0, 0}, 1U, 10U, 15U), {plant(1, 0.9, 0.05)});
    table.update(source({0, 0}, 2U, 10U, 20U), {plant(1, 1.0)});
  }
  EXPECT_EQ(table.plants()[0].passes, 1U);
  EXPECT_EQ(table.plants()[0].height.stddev, 0.01);
  // From later on, as after a crash: still the same scans.
  table.update(source({0, 0}, 1U, 12U, 19U), {plant(1, 0.9, 0.05)});
  EXPECT_EQ(table.plants()[0].passes, 1U);
  EXPECT_EQ(table.plants()[0].height.value, 1.0);
}

TEST(PlantTable, ARunThatSeesTheSameScansAgainTakesBackWhatAKilledOneThought) {
  PlantTable table;
  table.update(source({0, 0}, 1U, 10U, 12U), {plant(1, 1.0), plant(2, 0.3)});
  // Killed; the new process missed the first scans, and sees more than the old one did.
  EXPECT_EQ(table.update(source({0, 0}, 1U, 11U, 20U), {plant(1, 1.0)}).removed,
            std::vector<std::int32_t>{2});
  EXPECT_EQ(table.size(), 1U);
}

}  // namespace
}  // namespace field_phenotyping
