// Points by voxel, on all cores, against one point after the other.

#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <random>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/preprocessing/voxel_groups.hpp"

namespace field_phenotyping {
namespace {

constexpr float kEdge = 0.003F;  // [m]

/// Points about some columns, as plants stand: many voxels hold several.
std::vector<Eigen::Vector3f> plants(std::size_t count) {
  std::mt19937 random(3U);
  std::normal_distribution<float> aside(0.0F, 0.02F);
  std::uniform_real_distribution<float> any(-1.0F, 1.0F);
  std::vector<Eigen::Vector3f> points;
  for (std::size_t i = 0; i < count; ++i) {
    const auto column = static_cast<float>(random() % 7U);
    points.emplace_back(0.3F * column - 1.0F + aside(random), -0.0F + aside(random), any(random));
  }
  return points;
}

TEST(VoxelGroups, AreNumberedAsOnePointMeetsThemAfterTheOther) {
  for (const std::size_t count : {0U, 1U, 200U, 16384U, 16385U, 150000U}) {
    const std::vector<Eigen::Vector3f> points = plants(count);
    std::map<std::uint64_t, std::uint32_t> numbers;
    std::vector<std::uint32_t> of_point;
    std::vector<std::uint32_t> first;
    std::vector<VoxelMean> means;
    for (std::uint32_t i = 0; i < points.size(); ++i) {
      const Place place{points[i].x(), points[i].y(), points[i].z()};
      const auto [number, is_new] = numbers.try_emplace(voxelKeyOf(place, kEdge), numbers.size());
      if (is_new) {
        first.push_back(i);
        means.emplace_back();
      }
      of_point.push_back(number->second);
      means[number->second].add(place);
    }
    for (const int threads : {1, 0}) {
      const ThreadLimit limit(threads);
      const VoxelGroups groups(points, kEdge);
      ASSERT_EQ(groups.size(), first.size());
      EXPECT_EQ(groups.first(), first);
      EXPECT_EQ(groups.ofPoints(), of_point);
      const std::vector<VoxelMean> found = groups.means();
      ASSERT_EQ(found.size(), means.size());
      for (std::size_t k = 0; k < means.size(); ++k) {
        ASSERT_EQ(std::memcmp(&found[k], &means[k], sizeof(VoxelMean)), 0) << k;
      }
    }
  }
}

}  // namespace
}  // namespace field_phenotyping
