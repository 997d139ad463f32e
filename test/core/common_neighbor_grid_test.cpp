// Fixed-radius search against brute force.

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <random>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

std::vector<std::uint32_t> bruteForce(const Points& points, const Eigen::Vector3f& center,
                                      float radius) {
  std::vector<std::uint32_t> found;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if ((points[i] - center).squaredNorm() <= radius * radius) found.push_back(i);
  }
  return found;
}

void expectLikeBruteForce(const Points& points, const Points& centers, float cell, float radius) {
  const NeighborGrid grid(points, cell);
  ASSERT_EQ(grid.size(), points.size());
  std::vector<std::uint32_t> found;
  std::size_t total = 0U;
  for (const Eigen::Vector3f& center : centers) {
    grid.within(center, radius, found);
    std::sort(found.begin(), found.end());
    ASSERT_EQ(found, bruteForce(points, center, radius))
        << "at " << center.transpose() << ", cell " << cell << ", radius " << radius;
    total += found.size();
    const auto count = static_cast<std::uint32_t>(found.size());
    EXPECT_TRUE(grid.hasWithin(center, radius, count));
    EXPECT_FALSE(grid.hasWithin(center, radius, count + 1U));
    std::vector<std::uint32_t> near;
    grid.forEachNearBox(center, center, radius, [&](std::uint32_t i, const Eigen::Vector3f& point) {
      EXPECT_EQ(point, points[i]);
      near.push_back(i);
    });
    std::sort(near.begin(), near.end());
    EXPECT_TRUE(std::includes(near.begin(), near.end(), found.begin(), found.end()));
  }
  EXPECT_GT(total, 0U) << "the test looked only where nothing is";
}

Eigen::Vector3f nearestOnLine(const Eigen::Vector3f& begin, const Eigen::Vector3f& end,
                              const Eigen::Vector3f& point) {
  const Eigen::Vector3d line = (end - begin).cast<double>();
  const double share = line.dot((point - begin).cast<double>()) / line.squaredNorm();
  return (begin.cast<double>() + std::clamp(share, 0.0, 1.0) * line).cast<float>();
}

Points randomPoints(std::size_t count, const Eigen::Vector3f& low, const Eigen::Vector3f& high,
                    unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  Points points;
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3f share(unit(random), unit(random), unit(random));
    points.emplace_back(low + share.cwiseProduct(high - low));
  }
  return points;
}

TEST(NeighborGrid, RandomCloud) {
  const Points points = randomPoints(3000U, {-1.0F, -2.0F, -0.5F}, {1.5F, 0.5F, 1.0F}, 1U);
  const Points centers = randomPoints(200U, {-1.5F, -2.5F, -1.0F}, {2.0F, 1.0F, 1.5F}, 2U);
  for (const float radius : {0.02F, 0.1F, 0.35F}) {
    for (const float cell : {0.03F, 0.1F, 0.35F, 5.0F}) {
      expectLikeBruteForce(points, centers, cell, radius);
    }
  }
}

TEST(NeighborGrid, PointsAlongALine) {
  const Points points = randomPoints(3000U, {-1.0F, -2.0F, -0.5F}, {1.5F, 0.5F, 1.0F}, 1U);
  const Points ends = randomPoints(100U, {-1.5F, -2.5F, -1.0F}, {2.0F, 1.0F, 1.5F}, 2U);
  for (const float radius : {0.02F, 0.1F, 0.35F}) {
    const NeighborGrid grid(points, 0.1F);
    std::size_t total = 0U;
    for (std::size_t k = 0; k + 1U < ends.size(); ++k) {
      std::vector<std::uint32_t> found;
      grid.forEachWithinOfLine(ends[k], ends[k + 1U], radius,
                               [&](std::uint32_t i) { found.push_back(i); });
      std::sort(found.begin(), found.end());
      std::vector<std::uint32_t> expected;
      for (std::uint32_t i = 0; i < points.size(); ++i) {
        const Eigen::Vector3f nearest = nearestOnLine(ends[k], ends[k + 1U], points[i]);
        if ((points[i] - nearest).norm() <= radius) expected.push_back(i);
      }
      ASSERT_EQ(found, expected) << "radius " << radius;
      total += found.size();
    }
    EXPECT_GT(total, 0U) << "the test looked only where nothing is";
  }
}

TEST(NeighborGrid, EveryPointFindsItself) {
  const Points points = randomPoints(500U, {-1.0F, -1.0F, -1.0F}, {1.0F, 1.0F, 1.0F}, 3U);
  expectLikeBruteForce(points, points, 0.1F, 0.0F);
}

TEST(NeighborGrid, ClustersFarApart) {
  Points points;
  for (const float x : {-400.0F, 0.0F, 900.0F}) {
    const Eigen::Vector3f center(x, 0.3F * x, -0.01F * x);
    const Eigen::Vector3f half = Eigen::Vector3f::Constant(0.05F);
    for (const Eigen::Vector3f& point : randomPoints(300U, center - half, center + half, 4U)) {
      points.push_back(point);
    }
  }
  expectLikeBruteForce(points, points, 0.02F, 0.03F);
}

TEST(NeighborGrid, LatticeOnCellBorders) {
  Points points;
  for (int x = -6; x <= 6; ++x) {
    for (int y = -6; y <= 6; ++y) {
      for (int z = -6; z <= 6; ++z) {
        points.emplace_back(0.125F * Eigen::Vector3f(static_cast<float>(x), static_cast<float>(y),
                                                     static_cast<float>(z)));
      }
    }
  }
  // The neighbours at exactly the radius count.
  expectLikeBruteForce(points, points, 0.125F, 0.125F);
  expectLikeBruteForce(points, points, 0.25F, 0.25F);
}

TEST(NeighborGrid, PlanesLinesAndOnePlace) {
  Points plane = randomPoints(800U, {-1.0F, -1.0F, 0.0F}, {1.0F, 1.0F, 0.0F}, 5U);
  expectLikeBruteForce(plane, plane, 0.1F, 0.1F);
  Points line = randomPoints(400U, {0.0F, 2.0F, -3.0F}, {0.0F, 2.0F, 3.0F}, 6U);
  expectLikeBruteForce(line, line, 0.1F, 0.25F);
  expectLikeBruteForce(Points(50U, {1.0F, 2.0F, 3.0F}), {{1.0F, 2.0F, 3.0F}}, 0.1F, 0.1F);
}

TEST(NeighborGrid, OnePointAndNone) {
  expectLikeBruteForce({{-5.0F, 3.0F, 1.0F}}, {{-5.0F, 3.05F, 1.0F}, {0.0F, 0.0F, 0.0F}}, 0.1F,
                       0.1F);
  const NeighborGrid empty(Points(), 0.1F);
  std::vector<std::uint32_t> found{1U, 2U};
  empty.within({0.0F, 0.0F, 0.0F}, 1.0F, found);
  EXPECT_TRUE(found.empty());
}

TEST(NeighborGrid, GivesSquaredDistances) {
  const Points points = randomPoints(200U, {0.0F, 0.0F, 0.0F}, {1.0F, 1.0F, 1.0F}, 7U);
  const NeighborGrid grid(points, 0.2F);
  const Eigen::Vector3f center(0.5F, 0.5F, 0.5F);
  grid.forEachWithin(center, 0.4F, [&](std::uint32_t i, float squared) {
    EXPECT_FLOAT_EQ(squared, (points[i] - center).squaredNorm());
  });
}

TEST(NeighborGrid, SameOrderEveryTime) {
  const Points points = randomPoints(2000U, {-1.0F, -1.0F, -1.0F}, {1.0F, 1.0F, 1.0F}, 8U);
  const NeighborGrid first(points, 0.1F);
  const NeighborGrid second(points, 0.1F);
  std::vector<std::uint32_t> a;
  std::vector<std::uint32_t> b;
  first.within({0.1F, -0.2F, 0.3F}, 0.5F, a);
  second.within({0.1F, -0.2F, 0.3F}, 0.5F, b);
  ASSERT_GT(a.size(), 50U);
  EXPECT_EQ(a, b);
}

TEST(NeighborGrid, ManyPointsAreSortedByRowCellAndNumber) {
  // Tables of cells, of several cells, and none.
  for (const float cell : {0.1F, 0.007F, 0.0005F}) {
    const Points points = randomPoints(50000U, {-1.0F, -1.0F, -1.0F}, {1.0F, 1.0F, 1.0F}, 9U);
    const GridGeometry geometry = gridGeometry(points, cell);
    ASSERT_EQ(geometry.has_table, cell > 0.001F);
    ASSERT_EQ(geometry.bucket_shift > 0U, geometry.has_table && cell < 0.01F);
    const auto placeOf = [&](std::uint32_t i) {
      const auto row = geometry.rowOf(geometry.cellOf(points[i].y(), 1),  //
                                      geometry.cellOf(points[i].z(), 2));
      return std::make_tuple(row, geometry.cellOf(points[i].x(), 0), i);
    };
    std::vector<std::uint32_t> expected(points.size());
    std::iota(expected.begin(), expected.end(), 0U);
    std::sort(expected.begin(), expected.end(),
              [&](std::uint32_t a, std::uint32_t b) { return placeOf(a) < placeOf(b); });
    const NeighborGrid grid(points, cell);
    for (std::size_t k = 0; k < points.size(); ++k) ASSERT_EQ(grid.sorted(k), expected[k]) << k;
    const Points centers(points.begin(), points.begin() + 20);
    expectLikeBruteForce(points, centers, cell, cell);
  }
}

TEST(NeighborGrid, RefusesWhatItCannotHold) {
  const Points points = {{0.0F, 0.0F, 0.0F}, {1.0F, 1.0F, 1.0F}};
  EXPECT_THROW(NeighborGrid(points, 0.0F), std::invalid_argument);
  EXPECT_THROW(NeighborGrid(points, -0.1F), std::invalid_argument);
  EXPECT_THROW(NeighborGrid(points, std::numeric_limits<float>::quiet_NaN()),
               std::invalid_argument);
  EXPECT_THROW(NeighborGrid({{0.0F, 0.0F, 0.0F}, {1e6F, 0.0F, 0.0F}}, 0.1F), std::invalid_argument);
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_THROW(NeighborGrid({{0.0F, 0.0F, 0.0F}, {infinity, 0.0F, 0.0F}}, 0.1F),
               std::invalid_argument);
}

}  // namespace
}  // namespace field_phenotyping
