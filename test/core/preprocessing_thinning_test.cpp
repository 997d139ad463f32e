// What is so dense that more points tell little more is averaged in wider voxels.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "field_phenotyping/preprocessing/thinning.hpp"

namespace field_phenotyping {
namespace {

constexpr double kEdge = 0.003;  // [m] of the voxels that the points come from

PointCloud no_feet, no_isolated;

/// Points on a layer of leaves 3 m by 3 m, so many on a square metre.
PointCloud layer(double density) {
  constexpr double kWide = 3.0;
  std::mt19937 random(1U);
  std::uniform_real_distribution<float> place(-1.5F, 1.5F);
  PointCloud cloud;
  cloud.origin = {448262.0, 5411932.0, 90.0};
  for (int i = 0; i < static_cast<int>(density * kWide * kWide); ++i) {
    const float x = place(random);
    cloud.points.emplace_back(x, place(random), 0.8F + 0.1F * x);
  }
  return cloud;
}

TEST(Thinning, LeavesAloneWhatIsNoDenser) {
  const PointCloud before = layer(9000.0);
  PointCloud cloud = before;
  EXPECT_TRUE(thin(cloud, no_feet, no_isolated, 10000.0, kEdge).empty());
  EXPECT_EQ(cloud.points, before.points);
  PointCloud none;
  EXPECT_TRUE(thin(none, no_feet, no_isolated, 10000.0, kEdge).empty());
}

TEST(Thinning, KeepsWithinTheDensityButNoFartherThanItMust) {
  for (const double density : {5000.0, 20000.0}) {
    PointCloud cloud = layer(60000.0);
    const std::size_t all = cloud.size();
    const DensePoints dense = thin(cloud, no_feet, no_isolated, density, kEdge);
    EXPECT_EQ(dense.points.size(), all);
    EXPECT_LE(static_cast<double>(cloud.size()), density * 9.6) << "0.1 m cells at its rim count";
    EXPECT_GE(static_cast<double>(cloud.size()), 0.4 * density * 9.0) << "widths double the area";
    EXPECT_EQ(cloud.origin, layer(1.0).origin);
  }
}

TEST(Thinning, FewPlantsKeepAllTheirPoints) {
  PointCloud cloud;
  for (int i = 0; i < 20000; ++i) {  // a stem of 2 cm, a million points on its square metre
    const float angle = 0.7F * static_cast<float>(i);
    cloud.points.emplace_back(0.01F * std::cos(angle), 0.01F * std::sin(angle),
                              1e-4F * static_cast<float>(i));
  }
  EXPECT_TRUE(thin(cloud, no_feet, no_isolated, 10000.0, kEdge).empty());
}

TEST(Thinning, EachPointStandsForThoseAroundIt) {
  for (const double density : {20000.0, 4000.0}) {
    PointCloud cloud = layer(60000.0);
    const DensePoints dense = thin(cloud, no_feet, no_isolated, density, kEdge);
    ASSERT_EQ(dense.thinned.size(), dense.points.size());
    std::vector<Eigen::Vector3d> sums(cloud.size(), Eigen::Vector3d::Zero());
    std::vector<double> counts(cloud.size(), 0.0);
    std::vector<bool> is_measured(cloud.size(), false);
    for (std::size_t i = 0; i < dense.points.size(); ++i) {
      ASSERT_LT(dense.thinned[i], cloud.size());
      const Eigen::Vector3f& stands = cloud.points[dense.thinned[i]];
      ASSERT_LT((dense.points[i] - stands).norm(), 0.03F * std::sqrt(3.0F));
      sums[dense.thinned[i]] += dense.points[i].cast<double>();
      counts[dense.thinned[i]] += 1.0;
      if (dense.points[i] == stands) is_measured[dense.thinned[i]] = true;
    }
    std::size_t means = 0U;
    std::size_t measured = 0U;
    for (std::size_t k = 0; k < cloud.size(); ++k) {
      ASSERT_GT(counts[k], 0.0) << "stands for nothing";
      if ((sums[k] / counts[k] - cloud.points[k].cast<double>()).norm() < 1e-5) ++means;
      if (is_measured[k]) ++measured;
    }
    const bool wide = density < 10000.0;
    EXPECT_EQ(means == cloud.size(), !wide);
    EXPECT_EQ(measured == cloud.size(), wide) << "centroids would lie inside of stems";
  }
}

TEST(Thinning, FeetAreThinnedToTheSameVoxels) {
  PointCloud cloud = layer(60000.0);
  PointCloud feet = layer(30000.0);
  const std::size_t all = cloud.size();
  const std::vector<Eigen::Vector3f> before = feet.points;
  const DensePoints dense = thin(cloud, feet, no_isolated, 20000.0, kEdge);
  ASSERT_EQ(dense.points.size(), all + before.size());
  EXPECT_LT(feet.size(), before.size());
  for (std::size_t i = 0; i < before.size(); ++i) {
    EXPECT_EQ(dense.points[all + i], before[i]);
    ASSERT_GE(dense.thinned[all + i], cloud.size());
    ASSERT_LT(dense.thinned[all + i], cloud.size() + feet.size());
    EXPECT_LT((feet.points[dense.thinned[all + i] - cloud.size()] - before[i]).norm(), 0.03F);
  }
  PointCloud few = layer(1000.0);
  EXPECT_TRUE(thin(few, feet, no_isolated, 20000.0, kEdge).empty())
      << "where the cloud is not, they are not";
}

TEST(Thinning, ColoursAndTheSensorsPlacesStayWithTheirPoints) {
  PointCloud cloud = layer(60000.0);
  cloud.scan_origins = {{0.0F, 0.0F, 2.0F}, {1.0F, 0.0F, 2.0F}};
  for (const Eigen::Vector3f& point : cloud.points) {
    cloud.colors.push_back(point.x() < 0.0F ? 0x204060U : 0x6080A0U);
    cloud.scan_origin.push_back(point.x() < 0.0F ? 0U : 1U);
  }
  thin(cloud, no_feet, no_isolated, 5000.0, kEdge);
  ASSERT_EQ(cloud.colors.size(), cloud.size());
  ASSERT_EQ(cloud.scan_origin.size(), cloud.size());
  EXPECT_EQ(cloud.scan_origins.size(), 2U);
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const float x = cloud.points[i].x();
    if (std::abs(x) < 0.03F) continue;  // of both
    EXPECT_EQ(cloud.colors[i], x < 0.0F ? 0x204060U : 0x6080A0U);
    EXPECT_EQ(cloud.scan_origin[i], x < 0.0F ? 0U : 1U);
  }
}

}  // namespace
}  // namespace field_phenotyping
