// Points right above stems that no organ leads to.

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/crown_points.hpp"

namespace field_phenotyping {
namespace {

constexpr double kNowhere = std::numeric_limits<double>::infinity();

/// Two stems of 2 m, 20 cm apart, that lean alike. The soil is at height 0.
struct Crowns {
  Block block;
  std::vector<StemAxis> axes;
  PointOwners owners;
  PointOwners isolated;
  double sparse_from = kNowhere;

  explicit Crowns(float lean = 0.0F) {
    for (const float x : {0.0F, 0.2F}) {
      axes.emplace_back(std::vector<StemAxis::Node>{{{x, 0.0F, 0.0F}, 0.012F},
                                                    {{x + lean, 0.0F, 1.0F}, 0.01F},
                                                    {{x + 2.0F * lean, 0.0F, 2.0F}, 0.005F}});
      add(axes.back().pointAt(1.9F), static_cast<std::int32_t>(axes.size()) - 1);
    }
  }
  std::size_t add(const Eigen::Vector3f& point, std::int32_t of = -1) {
    block.cloud.points.push_back(point);
    owners.stem.push_back(-1);
    owners.plant.push_back(of);
    return owners.plant.size() - 1U;
  }
  std::size_t addIsolated(const Eigen::Vector3f& point) {
    block.isolated.points.push_back(point);
    isolated.stem.push_back(-1);
    isolated.plant.push_back(-1);
    return isolated.plant.size() - 1U;
  }
  /// Off the line of a stem. @param above its end [m]
  Eigen::Vector3f over(std::size_t plant, float above, float aside) const {
    const StemAxis& axis = axes[plant];
    return axis.pointAt(axis.length() + above) + Eigen::Vector3f(0.0F, aside, 0.0F);
  }
  std::int32_t ownerOf(std::size_t i) const { return owners.plant[i]; }
  void give() { giveCrownPoints(block, axes, sparse_from, owners, isolated); }
};

TEST(CrownPoints, GoToTheStemThatTheyStandAbove) {
  for (const float lean : {0.0F, 0.2F}) {
    Crowns crowns(lean);
    std::vector<std::size_t> of_first;
    std::vector<std::size_t> of_second;
    for (const float above : {0.15F, 0.3F, 0.5F}) {
      of_first.push_back(crowns.add(crowns.over(0, above, 0.02F)));
      of_second.push_back(crowns.add(crowns.over(1, above, -0.03F)));
    }
    crowns.give();
    for (const std::size_t i : of_first) EXPECT_EQ(crowns.ownerOf(i), 0) << "lean " << lean;
    for (const std::size_t i : of_second) EXPECT_EQ(crowns.ownerOf(i), 1) << "lean " << lean;
  }
}

TEST(CrownPoints, WhatIsAnothersStaysSoWhereLeavesLeadToIt) {
  Crowns crowns;
  const std::size_t leaf = crowns.add(crowns.over(0, 0.2F, 0.0F), 1);
  crowns.give();
  EXPECT_EQ(crowns.ownerOf(leaf), 1);
}

TEST(CrownPoints, WhatIsAnothersGoesToTheStemBelowWhereLittleIsSeen) {
  Crowns crowns;
  crowns.sparse_from = 2.1;
  const std::size_t low = crowns.add(crowns.over(0, 0.05F, 0.0F), 1);
  std::vector<std::size_t> high;
  for (const float above : {0.2F, 0.24F, 0.28F}) {
    high.push_back(crowns.add(crowns.over(0, above, 0.0F), 1));
  }
  const std::size_t alone = crowns.add(crowns.over(0, 0.5F, 0.0F), 1);
  const std::size_t between = crowns.add({0.09F, 0.0F, 2.2F}, 1);
  const std::size_t stem = crowns.add(crowns.over(0, 0.25F, 0.0F), 1);
  crowns.owners.stem[stem] = 1;
  crowns.give();
  EXPECT_EQ(crowns.ownerOf(low), 1);
  for (const std::size_t i : high) EXPECT_EQ(crowns.ownerOf(i), 0);
  EXPECT_EQ(crowns.ownerOf(alone), 1) << "no more of it stands there";
  EXPECT_EQ(crowns.ownerOf(between), 1) << "its owner is nearly as near";
  EXPECT_EQ(crowns.ownerOf(stem), 1);
}

TEST(CrownPoints, OutliersThatStandAboveStemsAreTheirs) {
  Crowns crowns;
  crowns.sparse_from = 2.1;
  const std::size_t low = crowns.addIsolated(crowns.over(0, 0.05F, 0.02F));
  const std::size_t first = crowns.addIsolated(crowns.over(0, 0.3F, 0.02F));
  const std::size_t second = crowns.addIsolated(crowns.over(1, 0.4F, -0.03F));
  crowns.give();
  EXPECT_EQ(crowns.isolated.plant[low], -1);
  EXPECT_EQ(crowns.isolated.plant[first], 0);
  EXPECT_EQ(crowns.isolated.plant[second], 1);
}

TEST(CrownPoints, DustIsNoPlants) {
  Crowns crowns;
  crowns.sparse_from = 2.1;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> aside(-0.5F, 0.5F);
  std::uniform_real_distribution<float> height(2.1F, 3.5F);
  for (int k = 0; k < 2000; ++k) {
    crowns.addIsolated({aside(random), aside(random), height(random)});
  }
  crowns.give();
  const auto& plants = crowns.isolated.plant;
  EXPECT_TRUE(std::all_of(plants.begin(), plants.end(), [](std::int32_t of) { return of < 0; }));
}

TEST(CrownPoints, NotWhatStandsBesideTheLineOrBelowTheEnd) {
  for (const bool sparse : {false, true}) {
    Crowns crowns;
    if (sparse) crowns.sparse_from = 0.0;
    const std::size_t near = crowns.add(crowns.over(0, 0.1F, 0.08F));
    const std::size_t lone = crowns.add(crowns.over(0, 0.1F, 0.14F));
    const std::size_t others = crowns.add(crowns.over(0, 0.1F, 0.14F), 1);
    const std::size_t between = crowns.add(crowns.over(0, 0.1F, 0.18F));
    const std::size_t beside = crowns.add({-0.22F, 0.0F, 2.1F});
    const std::size_t below = crowns.add(crowns.over(0, -0.5F, 0.03F));
    crowns.give();
    EXPECT_EQ(crowns.ownerOf(near), sparse ? 0 : -1) << "farther off where little is seen";
    EXPECT_EQ(crowns.ownerOf(lone), sparse ? 0 : -1) << "no other line is nearly as near";
    EXPECT_EQ(crowns.ownerOf(others), 1);
    EXPECT_EQ(crowns.ownerOf(between), -1) << "the other line is nearly as near";
    EXPECT_EQ(crowns.ownerOf(beside), -1);
    EXPECT_EQ(crowns.ownerOf(below), -1);
  }
}

TEST(CrownPoints, BranchesOfATallNeighbourAreNotAShortPlants) {
  for (const float gap : {0.05F, 0.25F}) {  // between points of the neighbour's
    Crowns crowns;
    crowns.sparse_from = 2.0;
    for (const float above : {gap, 2.0F * gap, 3.0F * gap}) {
      crowns.add(crowns.over(1, above, 0.01F));
    }
    const std::size_t branch = crowns.add(crowns.over(0, 0.3F, 0.08F));
    crowns.give();
    EXPECT_EQ(crowns.ownerOf(branch), gap < 0.1F ? -1 : 0) << "gaps are usual there";
    const std::size_t tassel = crowns.add(crowns.over(0, 0.3F, 0.03F));
    crowns.give();
    EXPECT_EQ(crowns.ownerOf(tassel), 0);
    EXPECT_EQ(crowns.ownerOf(branch), 0) << "it stands beside the tassel";
  }
}

TEST(CrownPoints, NotWhatHangsHighAboveThePlant) {
  for (const bool sparse : {false, true}) {
    Crowns crowns;
    if (sparse) crowns.sparse_from = 2.0;
    const std::size_t wire = crowns.add(crowns.over(0, sparse ? 0.9F : 0.7F, 0.0F));
    crowns.give();
    EXPECT_EQ(crowns.ownerOf(wire), -1);
    // Leaves that are known to be the plant's reach up to it.
    crowns.add({0.15F, 0.1F, sparse ? 2.5F : 2.6F}, 0);
    crowns.give();
    EXPECT_EQ(crowns.ownerOf(wire), 0);
  }
}

TEST(CrownPoints, NoPointsNoPlants) {
  Block block;
  PointOwners owners;
  PointOwners isolated;
  giveCrownPoints(block, {}, 0.0, owners, isolated);
  EXPECT_TRUE(owners.plant.empty());
  block.cloud.points = {{0.0F, 0.0F, 1.0F}};
  owners = {{-1}, {-1}};
  giveCrownPoints(block, {}, 0.0, owners, isolated);
  EXPECT_EQ(owners.plant.front(), -1);
}

}  // namespace
}  // namespace field_phenotyping
