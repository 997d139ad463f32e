// Voxel map and outlier filter against brute force.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <random>
#include <stdexcept>
#include <vector>

#include "field_phenotyping/preprocessing/outlier_filter.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTile = 2.0;
constexpr double kVoxel = 0.01;

struct ColoredPoint {
  Eigen::Vector3d position;
  std::uint32_t color;
};

std::vector<ColoredPoint> randomPoints(std::size_t count, const Eigen::Vector3d& low,
                                       const Eigen::Vector3d& high, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::vector<ColoredPoint> points;
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d share(unit(random), unit(random), unit(random));
    points.push_back(
        {low + share.cwiseProduct(high - low), static_cast<std::uint32_t>(random()) & 0xFFFFFFU});
  }
  return points;
}

VoxelMap mapOf(const std::vector<ColoredPoint>& points, double datum = 0.0) {
  VoxelMap map(kTile, kVoxel);
  map.setHeightDatum(datum);
  for (const ColoredPoint& point : points) {
    const BlockIndex index = map.tileAt(point.position.x(), point.position.y());
    const Eigen::Vector3d local = point.position - map.originOf(index);
    map.tile(index).insert(local.cast<float>(), map.voxelSize(), true, point.color);
  }
  return map;
}

struct Mean {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  std::array<double, 3> color{};
  double count = 0.0;
};

/// Mean place and colour of the points of every voxel. Tile origins lie on voxel borders here, so
/// voxels of the map frame are those of the tiles.
std::map<std::array<long, 3>, Mean> bruteForce(const std::vector<ColoredPoint>& points) {
  std::map<std::array<long, 3>, Mean> means;
  for (const ColoredPoint& point : points) {
    std::array<long, 3> key{};
    for (std::size_t axis = 0; axis < 3U; ++axis) {
      const double coordinate = point.position[static_cast<Eigen::Index>(axis)];
      key[axis] = static_cast<long>(std::floor(coordinate / kVoxel));
    }
    Mean& mean = means[key];
    mean.sum += point.position;
    for (std::size_t channel = 0; channel < 3U; ++channel) {
      mean.color[channel] += (point.color >> (16U - 8U * channel)) & 0xFFU;
    }
    mean.count += 1.0;
  }
  return means;
}

TEST(VoxelSlots, NumbersKeysAsTheyComeHoweverOftenItBeginsAnew) {
  std::mt19937_64 random(5U);
  for (const std::uint64_t alike : {1ULL, 1ULL << 42U}) {  // keys that differ low down, high up
    std::map<std::uint64_t, std::uint32_t> expected;
    std::vector<std::uint64_t> keys;
    VoxelSlots slots;
    for (int k = 0; k < 20000; ++k) {
      const std::uint64_t key = alike * (random() % 7000U);
      if (k % 5000 == 4999) slots = {};
      slots.makeRoom(keys, 1U);
      const std::uint32_t number = slots.find(key, VoxelSlots::hashOf(key), keys);
      if (number == keys.size()) keys.push_back(key);
      EXPECT_EQ(number, expected.try_emplace(key, expected.size()).first->second);
    }
    EXPECT_EQ(keys.size(), expected.size());
  }
}

TEST(VoxelTile, FilledAtOnceIsAsFilledPointByPointAndGoesOnToBe) {
  constexpr float kEdge = 0.003F;
  for (const std::size_t count : {0U, 1U, 63U, 64U, 65U, 50000U}) {
    for (const double extent : {0.02, 1.0}) {  // [m] many points a voxel, hardly any
      std::vector<Eigen::Vector3f> points;
      const Eigen::Vector3d half = Eigen::Vector3d::Constant(extent);
      for (const ColoredPoint& p : randomPoints(count, -half, half, 31U)) {
        points.push_back(p.position.cast<float>());
      }
      points.emplace_back(-0.0F, kEdge, -kEdge);  // on borders
      VoxelTile one_by_one;
      for (const Eigen::Vector3f& p : points) one_by_one.insert(p, kEdge, false, 0U);
      VoxelTile at_once;
      at_once.insertAll(points, kEdge, ComputeDevice());
      for (int further = 0; further < 2; ++further) {
        ASSERT_EQ(at_once.size(), one_by_one.size());
        for (std::size_t i = 0; i < at_once.size(); ++i) {
          const Eigen::Vector3f a = at_once.centroid(i);
          const Eigen::Vector3f b = one_by_one.centroid(i);
          ASSERT_EQ(std::memcmp(a.data(), b.data(), sizeof a), 0) << i;
        }
        at_once.rest();
        for (std::size_t i = 0; i < points.size(); i += 7U) {
          const Eigen::Vector3f p = 1.01F * points[i];
          EXPECT_EQ(at_once.insert(p, kEdge, false, 0U), one_by_one.insert(p, kEdge, false, 0U));
        }
      }
    }
  }
}

TEST(VoxelMap, CentroidsAndColoursAreMeans) {
  const auto points = randomPoints(20000U, {-2.3, -0.4, -0.2}, {-1.2, 0.7, 0.1}, 1U);
  const VoxelMap map = mapOf(points);
  const auto expected = bruteForce(points);
  EXPECT_EQ(map.tiles().size(), 4U) << "the points lie round a corner of four tiles";

  std::size_t voxels = 0U;
  for (const auto& [index, tile] : map.tiles()) {
    ASSERT_TRUE(tile.hasColors());
    for (std::size_t i = 0; i < tile.size(); ++i) {
      const Eigen::Vector3d centroid = map.originOf(index) + tile.centroid(i).cast<double>();
      std::array<long, 3> key{};
      for (std::size_t axis = 0; axis < 3U; ++axis) {
        const double coordinate = centroid[static_cast<Eigen::Index>(axis)];
        key[axis] = static_cast<long>(std::floor(coordinate / kVoxel));
      }
      const auto mean = expected.find(key);
      ASSERT_NE(mean, expected.end());
      EXPECT_LT((centroid - mean->second.sum / mean->second.count).norm(), 1e-6);
      for (std::size_t channel = 0; channel < 3U; ++channel) {
        const double value = (tile.color(i) >> (16U - 8U * channel)) & 0xFFU;
        EXPECT_NEAR(value, mean->second.color[channel] / mean->second.count, 1.0);
      }
      ++voxels;
    }
  }
  EXPECT_EQ(voxels, expected.size());
}

TEST(VoxelMap, FarFromTheOriginAsAtIt) {
  const Eigen::Vector3d far(500000.0, 4500000.0, 90.0);
  const auto points = randomPoints(5000U, {0.1, 0.1, 0.1}, {1.9, 1.9, 0.9}, 2U);
  std::vector<ColoredPoint> shifted = points;
  for (ColoredPoint& point : shifted) point.position += far;

  const VoxelMap near_map = mapOf(points);
  const VoxelMap far_map = mapOf(shifted, far.z());
  const PointCloud near_cloud = near_map.extract({near_map.tileAt(1.0, 1.0)}, 0.0);
  const PointCloud far_cloud = far_map.extract({far_map.tileAt(far.x() + 1.0, far.y() + 1.0)}, 0.0);
  EXPECT_LT((far_cloud.origin - far - near_cloud.origin).norm(), 1e-9);
  ASSERT_EQ(near_cloud.size(), far_cloud.size());
  for (std::size_t i = 0; i < near_cloud.size(); ++i) {
    ASSERT_LT((near_cloud.points[i] - far_cloud.points[i]).norm(), 1e-6F) << i;
  }
}

TEST(VoxelMap, CentroidStaysTrueHoweverOftenAVoxelIsHit) {
  // A rover that waits sees the same voxels for minutes.
  VoxelTile tile;
  std::mt19937 random(3U);
  std::uniform_real_distribution<float> unit(0.0F, 0.0009F);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  constexpr int kHits = 100000;
  for (int k = 0; k < kHits; ++k) {
    const Eigen::Vector3f point(0.9001F + unit(random), -0.7099F + unit(random),
                                0.3001F + unit(random));
    sum += point.cast<double>();
    EXPECT_EQ(tile.insert(point, static_cast<float>(kVoxel), false, 0U), k == 0);
  }
  EXPECT_LT((tile.centroid(0U).cast<double>() - sum / kHits).norm(), 1e-4);
}

TEST(VoxelMap, ColourIsThatOfTheColouredPoints) {
  VoxelTile tile;
  const auto voxel = static_cast<float>(kVoxel);
  for (int k = 0; k < 9; ++k) tile.insert({0.001F, 0.001F, 0.001F}, voxel, false, 0U);
  tile.insert({0.001F, 0.001F, 0.001F}, voxel, true, 0x40C0FFU);
  EXPECT_EQ(tile.color(0U), 0x40C0FFU) << "scans without colour must not darken it";
}

void expectTilesCoverThePlaneOnce(const Eigen::Vector2d& corner) {
  const VoxelMap map(kTile, kVoxel, corner);
  const Eigen::Vector2d places[] = {{0.0, 0.0},     {1.9999, 0.0},      {2.0, 0.0},
                                    {-1e-9, 0.0},   {-2.0, -2.0},       {-2.0001, 3.9999},
                                    {1e-9, 1e-9},   {500000.0, 4.5e6},  {499999.9999, 4499999.9999},
                                    {-500001, 0.3}, {0.7, -4500000.001}};
  for (const Eigen::Vector2d& place : places) {
    const BlockIndex index = map.tileAt(place.x(), place.y());
    int holders = 0;
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        BlockHeader header;
        header.tile_size = kTile;
        header.tile_corner = corner;
        header.index = {index.x + dx, index.y + dy};
        if (header.holds(place.x(), place.y())) {
          ++holders;
          EXPECT_EQ(header.index, index) << place.transpose();
        }
      }
    }
    EXPECT_EQ(holders, 1) << place.transpose();
    const Eigen::Vector2d away = map.originOf(index).head<2>() - place;
    EXPECT_LE(away.cwiseAbs().maxCoeff(), 0.5 * kTile + 1e-9);
  }
}

TEST(VoxelMap, TilesCoverThePlaneOnce) {
  expectTilesCoverThePlaneOnce({0.0, 0.0});
  expectTilesCoverThePlaneOnce({-0.625, 1000.5});
}

TEST(VoxelMap, ExtractTakesTheMarginOfNeighbours) {
  // Wider than a tile, so that two rings of neighbours are needed.
  for (const double margin : {0.0, 0.6, 2.5}) {
    const auto points = randomPoints(4000U, {-6.0, -6.0, 0.0}, {6.0, 6.0, 0.2}, 4U);
    const VoxelMap map = mapOf(points);
    const BlockIndex index{0, -1};
    const PointCloud cloud = map.extract({index}, margin);
    ASSERT_EQ(cloud.colors.size(), cloud.size());
    std::size_t expected = 0U;
    for (const auto& [tile_index, tile] : map.tiles()) {
      for (std::size_t i = 0; i < tile.size(); ++i) {
        const Eigen::Vector3d p = map.originOf(tile_index) + tile.centroid(i).cast<double>();
        const bool inside = p.x() >= -margin && p.x() <= kTile + margin &&
                            p.y() >= -kTile - margin && p.y() <= margin;
        expected += inside ? 1U : 0U;
      }
    }
    EXPECT_EQ(cloud.size(), expected) << "margin " << margin;
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const Eigen::Vector3d p = cloud.mapPoint(i);
      EXPECT_GT(p.x(), -margin - 1e-5);
      EXPECT_LT(p.x(), kTile + margin + 1e-5);
    }
  }
}

TEST(VoxelMap, ExtractTakesEachPointOfJoinedTilesOnce) {
  for (const double margin : {0.0, 0.6, 2.5}) {
    const auto points = randomPoints(4000U, {-6.0, -6.0, 0.0}, {6.0, 6.0, 0.2}, 5U);
    const VoxelMap map = mapOf(points);
    const std::vector<BlockIndex> wanted{{0, -1}, {1, -1}, {1, 0}};
    const PointCloud cloud = map.extract(wanted, margin);
    std::size_t expected = 0U;
    for (const auto& [tile_index, tile] : map.tiles()) {
      for (std::size_t i = 0; i < tile.size(); ++i) {
        const Eigen::Vector3d p = map.originOf(tile_index) + tile.centroid(i).cast<double>();
        const bool inside = std::any_of(wanted.begin(), wanted.end(), [&](const BlockIndex& w) {
          const Eigen::Vector2d away = p.head<2>() - map.originOf(w).head<2>();
          return away.cwiseAbs().maxCoeff() <= 0.5 * kTile + margin;
        });
        expected += inside ? 1U : 0U;
      }
    }
    EXPECT_EQ(cloud.size(), expected) << "margin " << margin;
    EXPECT_EQ(cloud.origin.head<2>(), Eigen::Vector2d(kTile, 0.0)) << "the middle";
  }
}

TEST(VoxelMap, ExtractOfNothing) {
  const VoxelMap map(kTile, kVoxel);
  EXPECT_TRUE(map.extract({BlockIndex{3, 4}}, 0.6).empty());
  EXPECT_EQ(map.find({3, 4}), nullptr);
}

TEST(VoxelMap, EraseForgetsATile) {
  VoxelMap map = mapOf(randomPoints(100U, {0.0, 0.0, 0.0}, {1.0, 1.0, 0.1}, 5U));
  ASSERT_NE(map.find({0, 0}), nullptr);
  map.erase({0, 0});
  EXPECT_EQ(map.find({0, 0}), nullptr);
  EXPECT_TRUE(map.extract({BlockIndex{0, 0}}, 0.6).empty());
}

TEST(VoxelKey, DistinctPerVoxelAndChecked) {
  const float voxel = 0.003F;
  EXPECT_EQ(voxelKey({0.0001F, 0.0F, 0.0F}, voxel), voxelKey({0.0029F, 0.001F, 0.002F}, voxel));
  EXPECT_NE(voxelKey({0.0001F, 0.0F, 0.0F}, voxel), voxelKey({-0.0001F, 0.0F, 0.0F}, voxel));
  EXPECT_NE(voxelKey({3000.0F, 0.0F, 0.0F}, voxel), voxelKey({0.0F, 3000.0F, 0.0F}, voxel));
  EXPECT_NO_THROW(voxelKey({-3140.0F, 3140.0F, 3140.0F}, voxel));
  // pcl::VoxelGrid would wrap round here and merge points that are kilometres apart.
  EXPECT_THROW(voxelKey({3200.0F, 0.0F, 0.0F}, voxel), std::out_of_range);
  EXPECT_THROW(voxelKey({0.0F, -3200.0F, 0.0F}, voxel), std::out_of_range);
  EXPECT_THROW(voxelKey({0.0F, 0.0F, 1e30F}, voxel), std::out_of_range);
  EXPECT_THROW(voxelKey({0.0F, std::nanf(""), 0.0F}, voxel), std::out_of_range);
}

PointCloud cloudOf(const std::vector<ColoredPoint>& points) {
  PointCloud cloud;
  for (const ColoredPoint& point : points) cloud.points.push_back(point.position.cast<float>());
  return cloud;
}

TEST(OutlierFilter, CountsNeighboursLikeBruteForce) {
  // Dense enough that the radius is taken as given.
  PointCloud cloud = cloudOf(randomPoints(3000U, {0.0, 0.0, 0.0}, {0.6, 0.6, 0.1}, 6U));
  for (const ColoredPoint& far : randomPoints(100U, {0.0, 0.0, 0.3}, {0.6, 0.6, 2.0}, 7U)) {
    cloud.points.push_back(far.position.cast<float>());
  }
  constexpr float kRadius = 0.05F;
  constexpr int kMinNeighbors = 3;
  const auto keep = radiusOutlierFilter(cloud, kRadius, kMinNeighbors);
  ASSERT_EQ(keep.size(), cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    int neighbors = -1;
    for (const Eigen::Vector3f& point : cloud.points) {
      neighbors += (point - cloud.points[i]).squaredNorm() <= kRadius * kRadius ? 1 : 0;
    }
    ASSERT_EQ(keep[i] != 0U, neighbors >= kMinNeighbors) << i << " has " << neighbors;
  }
  EXPECT_GT(std::count(keep.begin(), keep.end(), 0U), 50);
}

TEST(OutlierFilter, DoesNotEmptyASparseCloud) {
  PointCloud cloud = cloudOf(randomPoints(400U, {0.0, 0.0, 0.0}, {2.0, 2.0, 0.01}, 8U));
  cloud.points.emplace_back(1.0F, 1.0F, 5.0F);  // a bird
  const auto keep = radiusOutlierFilter(cloud, 0.02F, 2);
  EXPECT_GT(std::count(keep.begin(), keep.end(), 1U), 320);
  EXPECT_EQ(keep.back(), 0U);
}

TEST(OutlierFilter, OffEmptyAndOnePoint) {
  const PointCloud cloud = cloudOf(randomPoints(20U, {0.0, 0.0, 0.0}, {90.0, 90.0, 9.0}, 9U));
  const auto keep = radiusOutlierFilter(cloud, 0.05F, 0);
  EXPECT_EQ(std::count(keep.begin(), keep.end(), 1U), 20);
  EXPECT_TRUE(radiusOutlierFilter(PointCloud(), 0.05F, 2).empty());
  PointCloud one;
  one.points.emplace_back(1.0F, 2.0F, 3.0F);
  EXPECT_EQ(radiusOutlierFilter(one, 0.05F, 2), std::vector<std::uint8_t>{0U});
}

}  // namespace
}  // namespace field_phenotyping
