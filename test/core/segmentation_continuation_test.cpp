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

  void follow() { followStemsUp(block_, axes_, 0.001F, owner_); }

  Block block_;
  std::vector<StemAxis> axes_;
  std::vector<std::int32_t> owner_;
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
