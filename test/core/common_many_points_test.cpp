// What is done to many items on all cores, against one after the other.

#include <gtest/gtest.h>

#include <random>
#include <utility>
#include <vector>

#include "field_phenotyping/common/bounds.hpp"
#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/partitioned.hpp"
#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kCounts[] = {0U, 1U, 16384U, 16385U, 100000U};

TEST(IndicesWhere, AreThoseAskedFor) {
  for (const std::size_t count : kCounts) {
    const auto wanted = [](std::size_t i) { return i * i % 7U == 2U; };
    std::vector<std::uint32_t> expected;
    for (std::size_t i = 0; i < count; ++i) {
      if (wanted(i)) expected.push_back(static_cast<std::uint32_t>(i));
    }
    EXPECT_EQ(indicesWhere(count, wanted), expected);
    EXPECT_TRUE(indicesWhere(count, [](std::size_t) { return false; }).empty());
  }
}

TEST(Partitioned, HoldItemsInTheirOrder) {
  for (const std::size_t count : kCounts) {
    for (const std::size_t partitions : {1U, 2U, 100U}) {
      const auto partitionOf = [&](std::size_t i) { return i * 7919U % 101U % partitions; };
      std::vector<std::vector<std::size_t>> expected(partitions);
      for (std::size_t i = 0; i < count; ++i) expected[partitionOf(i)].push_back(i);
      const Partitioned<std::size_t> items(
          count, partitions, [&](std::size_t begin, std::size_t end, const auto& give) {
            for (std::size_t i = begin; i < end; ++i) give(partitionOf(i), i);
          });
      ASSERT_EQ(items.partitions(), partitions);
      for (std::size_t p = 0; p < partitions; ++p) {
        std::vector<std::size_t> found;
        items.forEachOf(p, [&](std::size_t i) { found.push_back(i); });
        EXPECT_EQ(found, expected[p]);
        EXPECT_EQ(items.sizeOf(p), expected[p].size());
        std::vector<std::size_t> backwards;
        items.forEachBackwards(p, [&](std::size_t i) { backwards.push_back(i); });
        EXPECT_EQ(backwards, std::vector<std::size_t>(found.rbegin(), found.rend()));
      }
    }
  }
}

TEST(Bounds, HoldAllPointsAndNoMore) {
  std::mt19937 random(2U);
  std::uniform_real_distribution<float> any(-3.0F, 5.0F);
  for (const std::size_t count : kCounts) {
    if (count == 0U) continue;
    std::vector<Eigen::Vector3f> points(count);
    for (Eigen::Vector3f& point : points) point = {any(random), any(random), 9.0F + any(random)};
    Bounds expected{points.front(), points.front()};
    for (const Eigen::Vector3f& point : points) {
      expected.low = expected.low.cwiseMin(point);
      expected.high = expected.high.cwiseMax(point);
    }
    EXPECT_EQ(boundsOf(points).low, expected.low);
    EXPECT_EQ(boundsOf(points).high, expected.high);
  }
}

TEST(Taken, PointsComeWithWhatIsKnownOfThem) {
  PointCloud cloud;
  cloud.origin = {1.0, 2.0, 3.0};
  cloud.scan_origins = {{0.0F, 0.0F, 2.0F}};
  for (std::uint32_t i = 0; i < 40000U; ++i) {
    cloud.points.emplace_back(static_cast<float>(i), 0.0F, 1.0F);
    cloud.colors.push_back(i);
    cloud.scan_origin.push_back(static_cast<std::uint16_t>(i % 2U == 0U ? 0U : kNoScanOrigin));
  }
  const std::vector<std::uint32_t> indices =
      indicesWhere(cloud.size(), [](std::size_t i) { return i % 3U != 0U; });
  PointCloud expected = cloud.emptyAlike();
  for (const std::uint32_t i : indices) expected.take(cloud, i);
  const PointCloud found = taken(cloud, indices);
  EXPECT_EQ(found.origin, expected.origin);
  EXPECT_EQ(found.points, expected.points);
  EXPECT_EQ(found.colors, expected.colors);
  EXPECT_EQ(found.scan_origins, expected.scan_origins);
  EXPECT_EQ(found.scan_origin, expected.scan_origin);
  cloud.colors.clear();
  cloud.scan_origin.clear();
  EXPECT_FALSE(taken(cloud, indices).hasColors());
  EXPECT_FALSE(taken(cloud, indices).hasScanOrigins());
}

}  // namespace
}  // namespace field_phenotyping
