// Points right above stems that no organ leads to.

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "field_phenotyping/segmentation/crown_points.hpp"

namespace field_phenotyping {
namespace {

/// Two stems of 2 m, 20 cm apart, that lean alike.
struct Crowns {
  Block block;
  std::vector<StemAxis> axes;
  std::vector<std::int32_t> owner;

  explicit Crowns(float lean) {
    for (const float x : {0.0F, 0.2F}) {
      axes.emplace_back(std::vector<StemAxis::Node>{{{x, 0.0F, 0.0F}, 0.012F},
                                                    {{x + lean, 0.0F, 1.0F}, 0.01F},
                                                    {{x + 2.0F * lean, 0.0F, 2.0F}, 0.005F}});
      add(axes.back().pointAt(1.9F), static_cast<std::int32_t>(axes.size()) - 1);
    }
  }
  std::size_t add(const Eigen::Vector3f& point, std::int32_t of = -1) {
    block.cloud.points.push_back(point);
    owner.push_back(of);
    return owner.size() - 1U;
  }
  /// Off the line of a stem. @param above its end [m]
  Eigen::Vector3f over(std::size_t plant, float above, float aside) const {
    const StemAxis& axis = axes[plant];
    return axis.pointAt(axis.length() + above) + Eigen::Vector3f(0.0F, aside, 0.0F);
  }
  void give() { giveCrownPoints(block, axes, owner); }
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
    for (const std::size_t i : of_first) EXPECT_EQ(crowns.owner[i], 0) << "lean " << lean;
    for (const std::size_t i : of_second) EXPECT_EQ(crowns.owner[i], 1) << "lean " << lean;
  }
}

TEST(CrownPoints, WhatIsAnothersStaysSo) {
  Crowns crowns(0.0F);
  const std::size_t leaf = crowns.add(crowns.over(0, 0.2F, 0.0F), 1);
  crowns.give();
  EXPECT_EQ(crowns.owner[leaf], 1);
}

TEST(CrownPoints, NotWhatStandsBesideTheLineOrBelowTheEnd) {
  Crowns crowns(0.0F);
  const std::size_t beside = crowns.add(crowns.over(0, 0.2F, 0.08F));
  const std::size_t below = crowns.add(crowns.over(0, -0.5F, 0.03F));
  crowns.give();
  EXPECT_EQ(crowns.owner[beside], -1);
  EXPECT_EQ(crowns.owner[below], -1);
}

TEST(CrownPoints, NotWhatHangsHighAboveThePlant) {
  Crowns crowns(0.0F);
  const std::size_t wire = crowns.add(crowns.over(0, 0.7F, 0.0F));
  crowns.give();
  EXPECT_EQ(crowns.owner[wire], -1);
  // Leaves that are known to be the plant's reach up to it.
  crowns.add({0.15F, 0.1F, 2.5F}, 0);
  crowns.give();
  EXPECT_EQ(crowns.owner[wire], 0);
}

TEST(CrownPoints, NoPointsNoPlants) {
  Crowns crowns(0.0F);
  crowns.block.cloud.points.clear();
  crowns.owner.clear();
  crowns.give();
  EXPECT_TRUE(crowns.owner.empty());
  Block block;
  block.cloud.points = {{0.0F, 0.0F, 1.0F}};
  std::vector<std::int32_t> owner = {-1};
  giveCrownPoints(block, {}, owner);
  EXPECT_EQ(owner.front(), -1);
}

}  // namespace
}  // namespace field_phenotyping
