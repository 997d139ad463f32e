// Local shapes: the eigenvalue solver beside Eigen's in double precision, the shapes beside brute
// force, and one algorithm whatever the team.

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstring>
#include <random>

#include "emulated_team.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/local_shape_team.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

Eigen::Vector3d toEigen(const Place& p) {
  return Eigen::Vector3d(p.x, p.y, p.z);
}

Symmetric3 symmetric(const Eigen::Matrix3d& m) {
  const auto f = [](double value) { return static_cast<float>(value); };
  return {f(m(0, 0)), f(m(1, 1)), f(m(2, 2)), f(m(0, 1)), f(m(1, 2)), f(m(2, 0))};
}

Eigen::Matrix3d matrixOf(const Symmetric3& s) {
  Eigen::Matrix3d m;
  m << s.xx, s.xy, s.zx, s.xy, s.yy, s.yz, s.zx, s.yz, s.zz;
  return m;
}

/// Values as Eigen finds them in double precision; vectors unit, across one another, and what they
/// should be.
void expectSolved(const Symmetric3& s) {
  const Eigen::Matrix3d m = matrixOf(s);
  const PrincipalAxes axes = principalAxes(s);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(m);
  const double size = std::max(m.cwiseAbs().maxCoeff(), 1e-35);
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(axes.values[k], solver.eigenvalues()[k], 2e-6 * size) << m;
    const Eigen::Vector3d v = toEigen(axes.axes[k]);
    EXPECT_NEAR(v.norm(), 1.0, 1e-6) << m;
    EXPECT_LT((m * v - axes.values[k] * v).norm(), 4e-6 * size) << m;
    EXPECT_NEAR(v.dot(toEigen(axes.axes[(k + 1) % 3])), 0.0, 2e-6) << m;
  }
}

TEST(PrincipalAxes, AreThoseOfRandomMatrices) {
  std::mt19937 random(7U);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 20000; ++trial) {
    Eigen::Matrix3d half;
    for (int k = 0; k < 9; ++k) half(k / 3, k % 3) = normal(random);
    // Of all sizes, and of all shapes from a ball to a thin line.
    Eigen::Vector3d extents;
    for (int k = 0; k < 3; ++k) extents[k] = std::pow(10.0, -3.0 * std::abs(normal(random)));
    const Eigen::Matrix3d turned = half.householderQr().householderQ();
    const double scale = std::pow(10.0, 3.0 * normal(random));
    const Eigen::Matrix3d m = scale * turned * extents.asDiagonal() * turned.transpose();
    expectSolved(symmetric(m));
    expectSolved(symmetric(scale * (half + half.transpose())));
    if (HasFailure()) return;
  }
}

TEST(PrincipalAxes, OfEqualValuesAreAnyUnitVectorsAcrossOneAnother) {
  for (const double scale : {1e-20, 1e-6, 1.0, 1e12}) {
    for (const Eigen::Vector3d& extents :
         {Eigen::Vector3d(1, 1, 1), Eigen::Vector3d(1, 1, 0), Eigen::Vector3d(0, 0, 1),
          Eigen::Vector3d(0, 1, 1), Eigen::Vector3d(1, 2, 2), Eigen::Vector3d(2, 1, 2),
          Eigen::Vector3d(1, 1, 1.0000001), Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(3, 2, 1)}) {
      const Eigen::Matrix3d m = scale * Eigen::Matrix3d(extents.asDiagonal());
      expectSolved(symmetric(m));
      const Eigen::Matrix3d turn =
          Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
      expectSolved(symmetric(turn * m * turn.transpose()));
    }
  }
}

/// Leaves, a stem and noise, and as many points again in one corner.
Points somePoints(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  Points points;
  for (std::size_t i = 0; i < count; ++i) {
    const float a = uniform(random);
    const float b = uniform(random);
    const float c = uniform(random);
    if (i % 4U == 0U) points.emplace_back(0.3F * a, 0.2F * b, 0.05F * c);
    if (i % 4U == 1U) points.emplace_back(0.1F + 0.01F * a, 0.1F + 0.01F * b, c);
    if (i % 4U == 2U) points.emplace_back(0.4F * a, 0.05F * b, 0.3F + 0.5F * a);
    if (i % 4U == 3U) points.emplace_back(0.03F * a, 0.03F * b, 0.03F * c);
  }
  return points;
}

TEST(LocalShape, IsThatOfTheNeighboursByBruteForce) {
  const Points points = somePoints(1500U, 3U);
  for (const float radius : {0.02F, 0.05F}) {
    for (const float cell : {0.02F, 0.05F, 0.2F}) {
      const NeighborGrid grid(points, cell);
      const std::vector<LocalShape> shapes = computeLocalShapes(points, grid, radius);
      ASSERT_EQ(shapes.size(), points.size());
      for (std::size_t i = 0; i < points.size(); ++i) {
        std::vector<Eigen::Vector3d> near;
        for (const Eigen::Vector3f& p : points) {
          const Eigen::Vector3f d = p - points[i];
          if (d.squaredNorm() <= radius * radius) near.push_back(d.cast<double>());
        }
        ASSERT_EQ(shapes[i].neighbors, near.size());
        if (near.size() < 5U) {
          EXPECT_EQ(shapes[i].linearity, 0.0F);
          continue;
        }
        Eigen::Vector3d mean = Eigen::Vector3d::Zero();
        for (const Eigen::Vector3d& d : near) mean += d / static_cast<double>(near.size());
        Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
        for (const Eigen::Vector3d& d : near) {
          covariance += (d - mean) * (d - mean).transpose() / static_cast<double>(near.size());
        }
        const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
        const Eigen::Vector3d values = solver.eigenvalues();
        EXPECT_NEAR(shapes[i].linearity, (values[2] - values[1]) / values[2], 1e-4);
        EXPECT_NEAR(shapes[i].curvature, values[0] / values.sum(), 1e-4);
        EXPECT_GE(shapes[i].direction.z(), 0.0F);
        const Eigen::Vector3d direction = shapes[i].direction.cast<double>();
        const Eigen::Vector3d normal = shapes[i].normal.cast<double>();
        EXPECT_LT((covariance * direction - values[2] * direction).norm(), 1e-4 * values[2]);
        EXPECT_LT((covariance * normal - values[0] * normal).norm(), 1e-4 * values[2]);
      }
      if (HasFailure()) return;
    }
  }
}

/// The same bits in every number.
bool sameBits(const LocalShapeNumbers& a, const LocalShape& b) {
  const float of_a[] = {a.direction.x, a.direction.y, a.direction.z, a.normal.x,
                        a.normal.y,    a.normal.z,    a.linearity,   a.curvature};
  const float of_b[] = {b.direction.x(), b.direction.y(), b.direction.z(), b.normal.x(),
                        b.normal.y(),    b.normal.z(),    b.linearity,     b.curvature};
  return std::memcmp(of_a, of_b, sizeof of_a) == 0 && a.neighbors == b.neighbors;
}

TEST(LocalShape, IsTheSameBitForBitWhateverTheTeamAndItsScratch) {
  constexpr float kRadius = 0.04F;
  const Points points = somePoints(240U, 5U);
  const NeighborGrid grid(points, kRadius);
  const std::vector<LocalShape> expected = computeLocalShapes(points, grid, kRadius);
  const GridView view = grid.view();
  struct Case {
    unsigned groups;
    std::uint32_t capacity;
    std::uint32_t chunk;
  };
  for (const Case& c : {Case{1U, 512U, 240U}, Case{2U, 16U, 32U}, Case{3U, 64U, 7U}}) {
    std::vector<float> x(c.capacity + kLanes), y(x), z(x);
    const CandidateTile tile{x.data(), y.data(), z.data(), c.capacity};
    std::vector<LocalShapeNumbers> shapes(points.size());
    std::vector<int> stored(points.size(), 0);
    runEmulatedTeam(c.groups, [&](const EmulatedTeam& team) {
      for (std::uint32_t begin = 0U; begin < view.size; begin += c.chunk) {
        shapeMomentsOfChunk(
            team, view, begin, std::min(view.size, begin + c.chunk), kRadius,
            [&](std::uint32_t) { return tile; },
            [&](std::uint32_t k, const Moments& moments) {
              shapes[view.order[k]] = localShapeOf(moments);
              ++stored[view.order[k]];
            });
      }
    });
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_EQ(stored[i], 1) << i;
      EXPECT_TRUE(sameBits(shapes[i], expected[i])) << i;
    }
  }
}

TEST(NeighborGrid, CountsTheSameWhateverTheTeam) {
  const Points points = somePoints(300U, 9U);
  for (const float cell : {0.03F, 0.3F, 0.0004F}) {  // the last without a table
    const NeighborGrid grid(points, cell);
    const GridView view = grid.view();
    runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
      for (std::size_t i = team.group(); i < points.size(); i += 8U * team.groups()) {
        const Place place = NeighborGrid::placeOf(points[i]);
        std::uint32_t expected = 0U;
        for (const Eigen::Vector3f& p : points) {
          if ((p - points[i]).squaredNorm() <= 0.0016F) ++expected;
        }
        EXPECT_EQ(countWithin(team.lanes(), view, place, 0.04F, 1000U), expected);
        EXPECT_EQ(countWithin(team.lanes(), view, place, 0.04F, 2U) >= 2U, expected >= 2U);
      }
    });
  }
}

}  // namespace
}  // namespace field_phenotyping
