// Which start points are worth growing from.

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "field_phenotyping/segmentation/stem_search.hpp"

namespace field_phenotyping {
namespace {

constexpr float kHeight = 1.2F;  // [m] of the plants

/// Points up a pole every `step` [m].
void addPole(Block& block, float from, float to, float step) {
  for (float z = from; z < to; z += step) block.cloud.points.emplace_back(0.0F, 0.0F, z);
}

std::vector<GrownStem> standOf(std::size_t stems, std::size_t with_hidden_foot) {
  std::vector<GrownStem> stand;
  for (std::size_t s = 0; s < stems; ++s) {
    const Eigen::Vector3f base(0.2F * static_cast<float>(s), 0.0F, 0.0F);
    GrownStem stem;
    stem.midline.axis =
        StemAxis({{base, 0.01F}, {base + kHeight * Eigen::Vector3f::UnitZ(), 0.01F}});
    stem.midline.hidden = s < with_hidden_foot ? 0.5F : 0.0F;
    stand.push_back(stem);
  }
  return stand;
}

/// Start points from low down, and others from high up.
std::vector<StemSeeds> lowAndHigh() {
  StemSeeds low;
  low.points = {{0.0F, 0.0F, 0.1F}, {0.0F, 0.0F, 0.5F}};
  StemSeeds high;
  high.points = {{0.0F, 0.0F, 0.7F}, {0.0F, 0.0F, 1.0F}};
  return {low, high};
}

TEST(StemSearch, FloatingStartPointsAreNoStems) {
  Block seen;
  addPole(seen, 0.0F, kHeight, 0.005F);
  const Canopy canopy(seen);
  const std::vector<StemSeeds> left =
      withoutFloating(lowAndHigh(), standOf(6U, 0U), seen.ground, canopy, kHeight);
  ASSERT_EQ(left.size(), 1U);
  EXPECT_EQ(left.front().points.front().z(), 0.1F);
}

TEST(StemSearch, FloatingStartPointsStayWhereFeetMayBeHidden) {
  Block seen;
  addPole(seen, 0.0F, kHeight, 0.005F);
  const auto countLeft = [](const Block& block, const std::vector<GrownStem>& stand) {
    return withoutFloating(lowAndHigh(), stand, block.ground, Canopy(block), kHeight).size();
  };
  EXPECT_EQ(countLeft(seen, standOf(6U, 1U)), 2U) << "one of the stand does hide its foot";
  EXPECT_EQ(countLeft(seen, standOf(3U, 0U)), 2U) << "too few show how the stand is seen";
  Block dark;
  addPole(dark, 0.6F, kHeight, 0.0005F);
  addPole(dark, 0.0F, 0.6F, 0.1F);
  EXPECT_EQ(countLeft(dark, standOf(6U, 0U)), 2U) << "hardly a point from below the canopy";
}

/// A stand of that much evidence for each metre.
std::vector<GrownStem> sureStandOf(std::size_t stems, std::size_t with_hidden_foot,
                                   float evidence) {
  std::vector<GrownStem> stand = standOf(stems, with_hidden_foot);
  for (GrownStem& stem : stand) stem.midline.evidence = evidence * kHeight;
  return stand;
}

TEST(StemSearch, StartPointsBesideKnownStemsAreTheirLeaves) {
  constexpr float kSpacing = 0.06F;
  constexpr float kSure = 0.6F * kMostEvidence;
  const auto isLeft = [&](std::vector<Eigen::Vector3f> points,
                          const std::vector<GrownStem>& stand) {
    StemSeeds seeds;
    seeds.points = std::move(points);
    return !withoutBeside({seeds}, stand, kSpacing).empty();
  };
  const std::vector<GrownStem> sure = sureStandOf(6U, 0U, kSure);
  const std::vector<Eigen::Vector3f> beside{{0.4F, 0.03F, 0.2F}, {0.4F, 0.08F, 0.9F}};
  EXPECT_FALSE(isLeft(beside, sure));
  EXPECT_TRUE(isLeft({{0.4F, 0.03F, 0.2F}, {0.4F, 0.10F, 0.9F}}, sure)) << "it leads away";
  EXPECT_TRUE(isLeft({{0.4F, 0.07F, 0.2F}, {0.4F, 0.01F, 0.9F}}, sure)) << "it begins elsewhere";
  EXPECT_TRUE(isLeft(beside, sureStandOf(6U, 0U, 0.4F * kMostEvidence))) << "hardly known stems";
  EXPECT_TRUE(isLeft(beside, sureStandOf(6U, 1U, kSure))) << "feet may be hidden";
  EXPECT_TRUE(isLeft(beside, sureStandOf(4U, 0U, kSure))) << "too few stems";
  std::vector<GrownStem> with_short = sure;
  StemAxis& axis = with_short[2].midline.axis;
  axis = axis.below(0.5F * kHeight);
  EXPECT_TRUE(isLeft(beside, with_short)) << "a stem shorter than the others";
}

}  // namespace
}  // namespace field_phenotyping
