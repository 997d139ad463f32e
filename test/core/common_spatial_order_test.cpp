#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

#include "field_phenotyping/common/spatial_order.hpp"

namespace field_phenotyping {
namespace {

std::vector<Eigen::Vector3f> pointsIn(const Eigen::Vector3f& box, std::size_t count) {
  std::mt19937 random(1U);
  std::uniform_real_distribution<float> any(0.0F, 1.0F);
  std::vector<Eigen::Vector3f> points(count);
  for (Eigen::Vector3f& point : points) {
    point = Eigen::Vector3f(any(random), any(random), any(random)).cwiseProduct(box) -
            Eigen::Vector3f(5.0F, 0.0F, -90.0F);
  }
  return points;
}

/// The bits of the three cells in turn, that of z highest.
std::uint64_t mortonKey(const Eigen::Vector3f& from_corner, float cell) {
  std::uint64_t key = 0U;
  for (unsigned bit = 0U; bit < 20U; ++bit) {
    for (unsigned axis = 0U; axis < 3U; ++axis) {
      const auto at = static_cast<std::uint64_t>(from_corner[static_cast<int>(axis)] / cell);
      key |= (at >> bit & 1U) << (3U * bit + axis);
    }
  }
  return key;
}

TEST(SpatialOrder, IsThatOfAMortonCurveThroughCells) {
  // Small enough for cells of 1 cm; larger; flat.
  for (const Eigen::Vector3f& box :
       {Eigen::Vector3f(2.0F, 1.0F, 2.5F), Eigen::Vector3f(30.0F, 9.0F, 2.0F),
        Eigen::Vector3f(0.0F, 1.0F, 0.0F)}) {
    const std::vector<Eigen::Vector3f> points = pointsIn(box, 3000U);
    Eigen::Vector3f low = points.front();
    Eigen::Vector3f high = low;
    for (const Eigen::Vector3f& point : points) {
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
    const float cell = std::max((high - low).maxCoeff() / 1023.0F, 0.01F);
    std::vector<std::pair<std::uint64_t, std::uint32_t>> expected;
    for (std::uint32_t i = 0; i < points.size(); ++i) {
      expected.emplace_back(mortonKey(points[i] - low, cell), i);
    }
    std::sort(expected.begin(), expected.end());
    const std::vector<std::uint32_t> order = spatialOrder(points);
    ASSERT_EQ(order.size(), points.size());
    for (std::size_t k = 0; k < order.size(); ++k) EXPECT_EQ(order[k], expected[k].second) << k;
  }
}

TEST(SpatialOrder, NearInSpaceIsNearInMemory) {
  const std::vector<Eigen::Vector3f> points = pointsIn({2.0F, 2.0F, 2.0F}, 20000U);
  const std::vector<std::uint32_t> order = spatialOrder(points);
  float way = 0.0F;
  for (std::size_t k = 1; k < order.size(); ++k) {
    way += (points[order[k]] - points[order[k - 1U]]).norm();
  }
  EXPECT_LT(way / static_cast<float>(order.size()), 0.12F);  // [m]; unordered it is 1.3
}

TEST(SpatialOrder, FewPoints) {
  EXPECT_TRUE(spatialOrder({}).empty());
  EXPECT_EQ(spatialOrder({Eigen::Vector3f(1.0F, 2.0F, 3.0F)}), std::vector<std::uint32_t>{0U});
  const std::vector<Eigen::Vector3f> alike(5U, Eigen::Vector3f(1.0F, 2.0F, 3.0F));
  std::vector<std::uint32_t> as_they_were(alike.size());
  std::iota(as_they_were.begin(), as_they_were.end(), 0U);
  EXPECT_EQ(spatialOrder(alike), as_they_were);
}

}  // namespace
}  // namespace field_phenotyping
