// What carries on a stem beyond its end.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "field_phenotyping/segmentation/stem_continuation.hpp"

namespace field_phenotyping {
namespace {

/// Two upright stems 0.2 m apart that end 1 m above the soil.
class Continuation : public ::testing::Test {
 protected:
  Continuation() {
    for (const float x : {0.0F, 0.2F}) {
      axes_.emplace_back(StemAxis({{{x, 0.0F, 0.0F}, 0.01F}, {{x, 0.0F, 1.0F}, 0.01F}}));
      add(Eigen::Vector3f(x, 0.0F, 0.0F), Eigen::Vector3f(x, 0.0F, 1.0F), x > 0.0F ? 1 : 0);
    }
  }

  /// A line of points every 4 mm; returns the span of its points.
  IndexSpan add(const Eigen::Vector3f& from, const Eigen::Vector3f& to, std::int32_t owner = -1) {
    IndexSpan span;
    span.begin = static_cast<std::uint32_t>(block_.cloud.points.size());
    const int steps = static_cast<int>((to - from).norm() / 0.004F);
    for (int k = 1; k <= steps; ++k) {
      const float share = static_cast<float>(k) / static_cast<float>(steps);
      block_.cloud.points.emplace_back(from + share * (to - from));
      owner_.push_back(owner);
    }
    span.end = static_cast<std::uint32_t>(block_.cloud.points.size());
    return span;
  }

  double shareOf(const IndexSpan& span, std::int32_t plant) const {
    const auto begin = owner_.begin();
    return static_cast<double>(std::count(begin + span.begin, begin + span.end, plant)) /
           span.size();
  }

  void follow() { ends_ = followStemsUp(block_, axes_, 0.001F, owner_); }

  Block block_;
  std::vector<StemAxis> axes_;
  std::vector<std::int32_t> owner_;
  std::vector<OrganEnd> ends_;
};

TEST_F(Continuation, SpikesGoToTheStemsBelowThem) {
  const IndexSpan left = add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.3F});
  const IndexSpan right = add({0.2F, 0.0F, 1.0F}, {0.2F, 0.0F, 1.3F});
  follow();
  EXPECT_GT(shareOf(left, 0), 0.95);
  EXPECT_GT(shareOf(right, 1), 0.95);
}

TEST_F(Continuation, ADroopingSpikeIsFollowed) {
  // A quarter of a radian in 0.3 m, towards the other plant.
  std::vector<IndexSpan> parts;
  Eigen::Vector3f from(0.0F, 0.0F, 1.0F);
  for (int k = 1; k <= 10; ++k) {
    const float angle = 0.025F * static_cast<float>(k);
    const Eigen::Vector3f to =
        from + 0.03F * Eigen::Vector3f(std::sin(angle), 0.0F, std::cos(angle));
    parts.push_back(add(from, to));
    from = to;
  }
  follow();
  for (const IndexSpan& part : parts) EXPECT_GT(shareOf(part, 0), 0.9);
}

TEST_F(Continuation, GapsAreCrossedWhereTheSpikeGoesOn) {
  const IndexSpan low = add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.1F});
  const IndexSpan high = add({0.0F, 0.0F, 1.16F}, {0.0F, 0.0F, 1.3F});
  follow();
  EXPECT_GT(shareOf(low, 0), 0.95);
  EXPECT_GT(shareOf(high, 0), 0.9);
}

TEST_F(Continuation, WhatCrossesAboveTheEndIsLeft) {
  const IndexSpan leaf = add({-0.2F, 0.0F, 1.07F}, {0.1F, 0.0F, 1.07F});
  follow();
  EXPECT_EQ(shareOf(leaf, -1), 1.0);
}

TEST_F(Continuation, WhatCrossesTheTipIsLeft) {
  const IndexSpan spike = add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.3F});
  // A leaf, 6 cm wide, that rises over the tip.
  std::vector<IndexSpan> leaf;
  for (int k = -5; k <= 5; ++k) {
    const float y = 0.006F * static_cast<float>(k);
    leaf.push_back(add({-0.03F, y, 1.30F}, {0.06F, y, 1.36F}));
  }
  follow();
  EXPECT_GT(shareOf(spike, 0), 0.9);
  for (const IndexSpan& part : leaf) EXPECT_LT(shareOf(part, 0), 0.4);
  EXPECT_NEAR(ends_[0].place.z(), 1.3, 0.03);
  EXPECT_TRUE(ends_[0].is_clear);
}

TEST_F(Continuation, SparseTipsAreFollowed) {
  const IndexSpan spike = add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.2F});
  std::vector<IndexSpan> tip;  // a point every 3 cm
  for (float z = 1.23F; z < 1.33F; z += 0.03F) {
    tip.push_back(add({0.0F, 0.0F, z - 0.005F}, {0.0F, 0.0F, z}));
  }
  follow();
  EXPECT_GT(shareOf(spike, 0), 0.95);
  tip.pop_back();  // alone beyond a gap it may be anything
  for (const IndexSpan& point : tip) EXPECT_EQ(shareOf(point, 0), 1.0);
}

TEST_F(Continuation, EndsTellHowWellTheyAreKnown) {
  add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.2F});
  for (float z = 1.0F; z < 1.2F; z += 0.03F) add({0.2F, 0.0F, z - 0.005F}, {0.2F, 0.0F, z});
  follow();
  EXPECT_NEAR(ends_[0].place.z(), 1.2, 0.025);
  EXPECT_GT(ends_[0].direction.z(), 0.99F);
  EXPECT_TRUE(ends_[0].is_clear);
  EXPECT_FALSE(ends_[1].is_clear);  // a point every 3 cm
}

TEST_F(Continuation, WhatStandsBesideIsLeft) {
  const IndexSpan beside = add({0.1F, 0.0F, 1.0F}, {0.1F, 0.0F, 1.3F});
  follow();
  EXPECT_EQ(shareOf(beside, -1), 1.0);
}

TEST_F(Continuation, StemsWithoutPointsGetNone) {
  const IndexSpan spike = add({0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, 1.3F});
  std::replace(owner_.begin(), owner_.end(), 0, -1);
  follow();
  EXPECT_EQ(shareOf(spike, 0), 0.0);
}

}  // namespace
}  // namespace field_phenotyping
