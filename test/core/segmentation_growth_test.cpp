// The steps of stem segmentation, each on its own: axis, local shape, growth, pruning, midline,
// top.

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <stdexcept>
#include <utility>

#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/midline_refinement.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"
#include "field_phenotyping/segmentation/stem_top.hpp"
#include "growth_room.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

StemAxis verticalAxis(float length, float radius) {
  return StemAxis({{{0.0F, 0.0F, 0.0F}, radius}, {{0.0F, 0.0F, length}, radius}});
}

StemAxis bentAxis() {
  return StemAxis({{{0.0F, 0.0F, 0.0F}, 0.012F},
                   {{0.02F, 0.0F, 0.4F}, 0.010F},
                   {{0.10F, 0.05F, 0.8F}, 0.009F},
                   {{0.25F, 0.05F, 1.2F}, 0.004F}});
}

Midline midlineAlong(StemAxis axis, float spread) {
  Midline midline;
  midline.axis = std::move(axis);
  midline.spread = spread;
  return midline;
}

std::vector<std::uint32_t> allOf(const Points& points) {
  std::vector<std::uint32_t> members(points.size());
  for (std::uint32_t i = 0; i < members.size(); ++i) members[i] = i;
  return members;
}

/// Points on the surface round `axis`, at angles within [0, arc] from x.
Points surfaceOf(const StemAxis& axis, std::size_t count, double noise, double arc, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal(0.0, noise);
  Points points;
  for (std::size_t k = 0; k < count; ++k) {
    const auto s = static_cast<float>(unit(random)) * axis.length();
    const Eigen::Vector3f along = axis.directionAt(s);
    const Eigen::Vector3f u = (Eigen::Vector3f::UnitX() - along.x() * along).normalized();
    const double angle = arc * unit(random);
    const Eigen::Vector3f out = static_cast<float>(std::cos(angle)) * u +
                                static_cast<float>(std::sin(angle)) * along.cross(u);
    points.emplace_back(axis.pointAt(s) +
                        (axis.radiusAt(s) + static_cast<float>(normal(random))) * out);
  }
  return points;
}

// ---------------------------------------------------------------------------- axis

TEST(StemAxis, ProjectsLikeBruteForce) {
  const StemAxis axis = bentAxis();
  std::mt19937 random(1U);
  std::uniform_real_distribution<float> across(-0.1F, 0.35F);
  std::uniform_real_distribution<float> up(0.02F, 1.15F);
  for (int k = 0; k < 300; ++k) {
    const Eigen::Vector3f point(across(random), across(random), up(random));
    const StemAxis::Projection at = axis.project(point);
    float nearest = std::numeric_limits<float>::max();
    constexpr int kSteps = 4000;
    // Past both ends too, since the axis goes on straight there.
    for (int step = -kSteps; step <= 2 * kSteps; ++step) {
      const float s = axis.length() * static_cast<float>(step) / kSteps;
      nearest = std::min(nearest, (axis.pointAt(s) - point).norm());
    }
    EXPECT_NEAR(at.distance, nearest, 1e-4F);
    EXPECT_NEAR((at.foot - point).norm(), at.distance, 1e-5F);
    EXPECT_LT((axis.pointAt(at.arc_length) - at.foot).norm(), 1e-5F);
    EXPECT_NEAR(at.direction.norm(), 1.0F, 1e-5F);
    EXPECT_FLOAT_EQ(at.radius, axis.radiusAt(at.arc_length));
  }
}

TEST(StemAxis, ProjectsOnToWhatDoesNotRise) {
  // Over the top and down again: the nearest place is not at the point's own height.
  const StemAxis axis({{{0.0F, 0.0F, 0.0F}, 0.01F},
                       {{0.0F, 0.0F, 1.0F}, 0.01F},
                       {{0.2F, 0.0F, 1.1F}, 0.01F},
                       {{0.3F, 0.0F, 0.5F}, 0.01F}});
  EXPECT_NEAR(axis.project({0.3F, 0.1F, 0.6F}).distance, 0.1F, 0.02F);
  EXPECT_NEAR(axis.project({0.0F, 0.1F, 0.6F}).arc_length, 0.6F, 1e-5F);
}

TEST(StemAxis, EndsGoOnStraight) {
  const StemAxis axis = verticalAxis(1.0F, 0.01F);
  EXPECT_LT((axis.pointAt(1.5F) - Eigen::Vector3f(0.0F, 0.0F, 1.5F)).norm(), 1e-6F);
  EXPECT_LT((axis.pointAt(-0.2F) - Eigen::Vector3f(0.0F, 0.0F, -0.2F)).norm(), 1e-6F);
  EXPECT_NEAR(axis.project({0.3F, 0.0F, -0.5F}).distance, 0.3F, 1e-6F);
  EXPECT_NEAR(axis.project({0.3F, 0.0F, -0.5F}).arc_length, -0.5F, 1e-6F);
  EXPECT_NEAR(axis.project({0.0F, 0.4F, 1.7F}).arc_length, 1.7F, 1e-6F);
  EXPECT_FLOAT_EQ(axis.radiusAt(7.0F), 0.01F);
}

TEST(StemAxis, InterpolatesAlongItself) {
  const StemAxis axis = bentAxis();
  EXPECT_NEAR(
      axis.length(),
      std::hypot(0.02, 0.4) + std::sqrt(0.08 * 0.08 + 0.05 * 0.05 + 0.16) + std::hypot(0.15, 0.4),
      1e-5);
  const float first = std::hypot(0.02F, 0.4F);
  EXPECT_NEAR(axis.radiusAt(0.5F * first), 0.011F, 1e-6F);
  EXPECT_NEAR(axis.pointAtHeight(0.2F).x(), 0.01F, 1e-6F);
  EXPECT_NEAR(axis.pointAtHeight(-0.2F).x(), -0.01F, 1e-6F);
  EXPECT_NEAR(axis.pointAtHeight(1.4F).x(), 0.325F, 1e-5F);
  EXPECT_NEAR(axis.pointAtHeight(0.8F).y(), 0.05F, 1e-6F);
  std::size_t segment = 1000U;  // wherever it begins to look
  for (const float z : {1.4F, 0.2F, 0.21F, -0.2F, 0.8F, 0.5F, 0.0F, 1.0F}) {
    EXPECT_EQ(axis.pointAtHeight(z, segment), axis.pointAtHeight(z)) << z;
    EXPECT_LT(segment + 1U, axis.nodes().size());
  }
}

TEST(StemAxis, BelowKeepsTheLowerPart) {
  const StemAxis axis = bentAxis();
  const StemAxis lower = axis.below(0.7F);
  EXPECT_NEAR(lower.length(), 0.7F, 1e-5F);
  for (const float s : {0.0F, 0.3F, 0.5F, 0.7F}) {
    EXPECT_LT((lower.pointAt(s) - axis.pointAt(s)).norm(), 1e-5F);
    EXPECT_NEAR(lower.radiusAt(s), axis.radiusAt(s), 1e-6F);
  }
  EXPECT_NEAR(axis.below(9.0F).length(), axis.length(), 1e-5F);
  EXPECT_GT(axis.below(-1.0F).length(), 0.0F);
  EXPECT_GT(axis.below(0.0F).length(), 0.0F);
}

TEST(StemAxis, ExtendsStraightOn) {
  const StemAxis axis = bentAxis();
  const StemAxis longer = axis.extendedBy(0.3F);
  EXPECT_NEAR(longer.length(), axis.length() + 0.3F, 1e-5F);
  for (const float s : {0.1F, 0.7F, axis.length(), axis.length() + 0.2F}) {
    EXPECT_LT((longer.pointAt(s) - axis.pointAt(s)).norm(), 1e-5F);
  }
  EXPECT_FLOAT_EQ(longer.radiusAt(longer.length()), axis.radiusAt(axis.length()));
  EXPECT_EQ(axis.extendedBy(0.0F).nodes().size(), axis.nodes().size());
  EXPECT_FLOAT_EQ(axis.extendedBy(-1.0F).length(), axis.length());
}

TEST(StemAxis, CutsAnywhereEvenJustAboveANode) {
  // A cut less than one rounding step above a node must not ask for two nodes in one place.
  for (float node = 0.11F; node < 0.2F; node += 0.0007F) {
    const StemAxis axis({{{1.7F, -1.3F, 0.9F}, 0.01F},
                         {{1.7F, -1.3F, 0.9F + node}, 0.01F},
                         {{1.7F, -1.3F, 1.9F}, 0.01F}});
    const float at = axis.project({1.7F, -1.3F, 0.9F + node}).arc_length;
    float cut = at;
    for (int k = 0; k < 8; ++k) {
      ASSERT_NO_THROW(axis.below(cut)) << "cut at " << cut << ", node at " << at;
      cut = std::nextafter(cut, 2.0F);
    }
  }
}

TEST(StemAxis, RefusesDegenerateNodes) {
  EXPECT_THROW(StemAxis(std::vector<StemAxis::Node>{}), std::invalid_argument);
  EXPECT_THROW(StemAxis({{{0.0F, 0.0F, 0.0F}, 0.01F}}), std::invalid_argument);
  EXPECT_THROW(StemAxis({{{0.0F, 0.0F, 1.0F}, 0.01F}, {{0.0F, 0.0F, 1.0F}, 0.01F}}),
               std::invalid_argument);
  EXPECT_TRUE(StemAxis().empty());
  EXPECT_EQ(StemAxis().length(), 0.0F);
}

// ---------------------------------------------------------------------------- local shape

TEST(LocalShape, LikePrincipalComponentsInDoublePrecision) {
  std::mt19937 random(2U);
  std::normal_distribution<float> normal;
  Points points;
  const Eigen::Vector3f away(3.0F, -4.0F, 1.5F);
  for (int k = 0; k < 1500; ++k) {
    points.emplace_back(away + Eigen::Vector3f(0.05F * normal(random), 0.02F * normal(random),
                                               0.10F * normal(random)));
  }
  constexpr float kRadius = 0.05F;
  const NeighborGrid grid(points, kRadius);
  const auto shapes = computeLocalShapes(points, grid, kRadius);
  ASSERT_EQ(shapes.size(), points.size());
  for (std::size_t i = 0; i < points.size(); i += 7U) {
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    std::vector<Eigen::Vector3d> near;
    for (const Eigen::Vector3f& point : points) {
      if ((point - points[i]).squaredNorm() > kRadius * kRadius) continue;
      near.push_back(point.cast<double>());
      mean += near.back();
    }
    ASSERT_EQ(shapes[i].neighbors, near.size());
    if (near.size() < 5U) {
      EXPECT_EQ(shapes[i].linearity, 0.0F);
      EXPECT_EQ(shapes[i].curvature, 0.0F);
      continue;
    }
    mean /= static_cast<double>(near.size());
    for (const Eigen::Vector3d& point : near) {
      covariance += (point - mean) * (point - mean).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Vector3d values = solver.eigenvalues();
    EXPECT_NEAR(shapes[i].linearity, (values[2] - values[1]) / values[2], 1e-3);
    EXPECT_NEAR(shapes[i].curvature, values[0] / values.sum(), 1e-3);
    EXPECT_GE(shapes[i].direction.z(), 0.0F);
    if (values[2] > 1.2 * values[1]) {
      const Eigen::Vector3d direction = solver.eigenvectors().col(2);
      EXPECT_GT(std::abs(direction.dot(shapes[i].direction.cast<double>())), 0.999);
    }
    if (values[1] > 1.2 * values[0]) {
      const Eigen::Vector3d normal_direction = solver.eigenvectors().col(0);
      EXPECT_GT(std::abs(normal_direction.dot(shapes[i].normal.cast<double>())), 0.999);
    }
  }
}

TEST(LocalShape, LinesPlanesAndOnePlace) {
  Points line;
  Points plane;
  for (int k = 0; k < 200; ++k) {
    line.push_back(0.001F * static_cast<float>(k) * Eigen::Vector3f(0.6F, 0.0F, 0.8F));
    plane.emplace_back(0.002F * static_cast<float>(k % 14), 0.002F * static_cast<float>(k / 14),
                       0.3F);
  }
  const LocalShape on_line = computeLocalShapes(line, NeighborGrid(line, 0.02F), 0.02F)[100];
  EXPECT_GT(on_line.linearity, 0.999F);
  EXPECT_GT(on_line.direction.dot(Eigen::Vector3f(0.6F, 0.0F, 0.8F)), 0.999F);
  const LocalShape on_plane = computeLocalShapes(plane, NeighborGrid(plane, 0.01F), 0.01F)[105];
  EXPECT_LT(on_plane.linearity, 0.2F);
  EXPECT_LT(on_plane.curvature, 1e-4F);
  EXPECT_GT(std::abs(on_plane.normal.z()), 0.999F);
  const Points same(50U, Eigen::Vector3f(1.0F, 2.0F, 3.0F));
  for (const LocalShape& shape : computeLocalShapes(same, NeighborGrid(same, 0.02F), 0.02F)) {
    EXPECT_TRUE(shape.direction.allFinite());
    EXPECT_TRUE(shape.normal.allFinite());
    EXPECT_EQ(shape.linearity, 0.0F);
  }
}

// ---------------------------------------------------------------------------- growth

/// A cloud whose local shapes are given rather than computed, all alike and just like a stem's.
class TinyCloud {
 public:
  explicit TinyCloud(Points points) : points_(std::move(points)), grid_(points_, 0.1F) {
    LocalShape shape;
    shape.direction = Eigen::Vector3f::UnitZ();
    shape.normal = Eigen::Vector3f::UnitX();
    shape.linearity = 1.0F;
    shape.curvature = 0.0F;
    shape.neighbors = 100U;
    shapes_.assign(points_.size(), shape);
  }

  GrowthScene scene() const { return {points_, shapes_, grid_}; }

 private:
  Points points_;
  std::vector<LocalShape> shapes_;
  NeighborGrid grid_;
};

/// So wide and so vague that every point near by is like the stem.
Midline vagueMidline() {
  return midlineAlong(verticalAxis(1.0F, 0.05F), 10.0F);
}

SegmentationParameters growthParameters(double alpha, double beta) {
  SegmentationParameters parameters;
  parameters.M = 0.1;
  parameters.r1 = 0.1;
  parameters.alpha = alpha;
  parameters.beta = beta;
  return parameters;
}

const Eigen::Vector3f kStart(0.0F, 0.0F, 0.0F);
const Eigen::Vector3f kEnd(0.0F, 0.0F, 1.0F);

TEST(RegionGrowth, WithoutCandidatesWalksStraightToTheEnd) {
  const TinyCloud cloud({{5.0F, 5.0F, 5.0F}});
  const auto steps = [&](double beta, double r1) {
    SegmentationParameters parameters = growthParameters(0.2, beta);
    parameters.r1 = r1;
    const testing::GrownRegion region = testing::growRegion(cloud.scene(), vagueMidline(), kStart,
                                                            kEnd, GrowthSettings(parameters));
    EXPECT_TRUE(region.points.empty());
    return region.steps;
  };
  // Eq 2 leaves beta * unit(end - s_k), so Eq 3 steps by beta * r1: 13 steps of 0.08 pass 1 m.
  EXPECT_EQ(steps(0.8, 0.1), 13);
  // The step is held within [0.5, 1] r1: 19 of 0.055 m; 10 of 0.11 m.
  EXPECT_EQ(steps(0.3, 0.11), 19);
  EXPECT_EQ(steps(1.0, 0.11), 10);
}

TEST(RegionGrowth, SpheresAlongTheWayCollect) {
  // Centres at 0, 0.08, ... 0.96; a point 0.09 m aside is within reach 0.1 m only where a centre
  // is less than sqrt(0.1^2 - 0.09^2) = 0.0436 m above or below it.
  Points points;
  for (int k = 0; k <= 200; ++k) points.emplace_back(0.09F, 0.0F, 0.005F * static_cast<float>(k));
  const TinyCloud cloud(points);
  SegmentationParameters parameters = growthParameters(0.0, 0.8);
  const testing::GrownRegion region =
      testing::growRegion(cloud.scene(), vagueMidline(), kStart, kEnd, GrowthSettings(parameters));
  std::vector<std::uint32_t> expected;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    for (int step = 0; step < 13; ++step) {
      if (std::abs(points[i].z() - 0.08F * static_cast<float>(step)) < 0.0435F) {
        expected.push_back(i);
        break;
      }
    }
  }
  EXPECT_EQ(region.steps, 13);
  EXPECT_EQ(region.points, expected);
  ASSERT_GT(expected.size(), 150U);

  // The same line farther aside is never reached.
  for (Eigen::Vector3f& point : points) point.x() = 0.101F;
  EXPECT_TRUE(testing::growRegion(TinyCloud(points).scene(), vagueMidline(), kStart, kEnd,
                                  GrowthSettings(parameters))
                  .points.empty());
}

TEST(RegionGrowth, MeanDirectionTurnsTheWalk) {
  // Eq 1: the candidates at s_0 lie along x and along y: mean direction (0.5, 0.5, 0).
  // Eq 2: v = 0.5 (0.5, 0.5, 0) + 0.5 (0, 0, 1) = (0.25, 0.25, 0.5), |v| = 0.612.
  // Eq 3: s_1 = 0.1 v = (0.025, 0.025, 0.05).
  const Eigen::Vector3f s_1(0.025F, 0.025F, 0.05F);
  const Eigen::Vector3f out = s_1.normalized();
  const Points points = {
      {0.09F, 0.0F, 0.0F},     {0.0F, 0.09F, 0.0F},  // candidates at s_0
      s_1 + 0.099F * out,                            // reached from s_1 only, and just
      s_1 + 0.101F * out,                            // just not
      {-0.08F, -0.08F, 0.05F},  // 0.11 m from the untwisted path, 0.15 from s_1
  };
  SegmentationParameters parameters = growthParameters(0.5, 0.5);
  parameters.max_growth_steps = 2;
  const testing::GrownRegion region = testing::growRegion(TinyCloud(points).scene(), vagueMidline(),
                                                          kStart, kEnd, GrowthSettings(parameters));
  EXPECT_EQ(region.steps, 2);
  EXPECT_EQ(region.points, (std::vector<std::uint32_t>{0U, 1U, 2U}));
}

TEST(RegionGrowth, OpposedCandidatesCancel) {
  // Mean direction zero: only beta is left, and the step is 0.5 r1 though |v| = 0.4.
  const Points points = {
      {0.09F, 0.0F, 0.0F}, {-0.09F, 0.0F, 0.0F}, {0.0F, 0.0F, 0.149F}, {0.0F, 0.0F, 0.151F}};
  SegmentationParameters parameters = growthParameters(0.6, 0.4);
  parameters.max_growth_steps = 2;
  const testing::GrownRegion region = testing::growRegion(TinyCloud(points).scene(), vagueMidline(),
                                                          kStart, kEnd, GrowthSettings(parameters));
  EXPECT_EQ(region.points, (std::vector<std::uint32_t>{0U, 1U, 2U}));
}

TEST(RegionGrowth, StopsWhereItLeavesTheSegment) {
  const TinyCloud cloud({{0.09F, 0.0F, -0.01F}, {5.0F, 5.0F, 5.0F}});
  // Eq 4, 5: the walk is over as soon as its projection leaves [0, 1].
  SegmentationParameters parameters = growthParameters(0.0, 1.0);
  const testing::GrownRegion forwards = testing::growRegion(
      cloud.scene(), vagueMidline(), kStart, {0.0F, 0.0F, 0.05F}, GrowthSettings(parameters));
  EXPECT_EQ(forwards.steps, 1);
  EXPECT_EQ(forwards.points, std::vector<std::uint32_t>{0U});
  // Drawn backwards by the points: out at the start.
  const TinyCloud behind({{0.0F, 0.0F, -0.09F}});
  parameters = growthParameters(1.0, 0.1);
  EXPECT_EQ(
      testing::growRegion(behind.scene(), vagueMidline(), kStart, kEnd, GrowthSettings(parameters))
          .steps,
      1U);
}

TEST(RegionGrowth, BoundedAndSafe) {
  const TinyCloud cloud({{0.0F, 0.0F, 0.0F}, {0.0F, 0.0F, 0.0F}, {0.02F, 0.0F, 0.3F}});
  SegmentationParameters parameters = growthParameters(0.2, 0.8);
  parameters.max_growth_steps = 4;
  EXPECT_EQ(
      testing::growRegion(cloud.scene(), vagueMidline(), kStart, kEnd, GrowthSettings(parameters))
          .steps,
      4U);
  // Nowhere to go: no direction, nothing joins.
  const testing::GrownRegion still = testing::growRegion(cloud.scene(), vagueMidline(), kStart,
                                                         kStart, GrowthSettings(parameters));
  EXPECT_EQ(still.steps, 0);
  EXPECT_TRUE(still.points.empty());
  // A point at the seed itself has no direction; it must not spoil the mean.
  parameters.max_growth_steps = 200;
  const testing::GrownRegion region =
      testing::growRegion(cloud.scene(), vagueMidline(), kStart, kEnd, GrowthSettings(parameters));
  EXPECT_EQ(region.points, (std::vector<std::uint32_t>{0U, 1U, 2U}));
  EXPECT_LT(region.steps, 25);
}

TEST(RegionGrowth, PointsAreAscendingAndOnce) {
  const Points points = surfaceOf(verticalAxis(1.0F, 0.012F), 1000U, 0.001, 2.0 * M_PI, 3U);
  const NeighborGrid grid(points, 0.02F);
  const auto shapes = computeLocalShapes(points, grid, 0.04F);
  const Midline midline = midlineAlong(verticalAxis(1.0F, 0.012F), 0.001F);
  const testing::GrownRegion region =
      testing::growRegion(GrowthScene{points, shapes, grid}, midline, kStart, kEnd,
                          GrowthSettings(SegmentationParameters()));
  EXPECT_GT(region.points.size(), 950U) << "a clean stem joins";
  EXPECT_TRUE(std::is_sorted(region.points.begin(), region.points.end()));
  const std::set<std::uint32_t> once(region.points.begin(), region.points.end());
  EXPECT_EQ(once.size(), region.points.size());
}

TEST(RegionGrowth, NoMoreJoinTheStricterMIs) {
  Points points = surfaceOf(verticalAxis(1.0F, 0.012F), 1500U, 0.003, 2.0 * M_PI, 4U);
  std::mt19937 random(5U);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  for (int k = 0; k < 1500; ++k) {  // leaf points and noise all round
    points.emplace_back(0.06F * unit(random), 0.06F * unit(random), 0.5F + 0.5F * unit(random));
  }
  const NeighborGrid grid(points, 0.02F);
  const auto shapes = computeLocalShapes(points, grid, 0.04F);
  const Midline midline = midlineAlong(verticalAxis(1.0F, 0.012F), 0.002F);
  SegmentationParameters parameters;
  parameters.alpha = 0.0;  // the same spheres for every M
  std::size_t most = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> counts;
  for (double M = 0.05; M <= 1.0; M += 0.05) {
    parameters.M = M;
    const std::size_t count = testing::growRegion(GrowthScene{points, shapes, grid}, midline,
                                                  kStart, kEnd, GrowthSettings(parameters))
                                  .points.size();
    EXPECT_LE(count, most) << "M " << M;
    most = count;
    counts.push_back(count);
  }
  EXPECT_GT(counts.front(), 1500U);
  EXPECT_LT(counts.back(), 150U) << "hardly anything is perfectly alike";
}

float similarity(const GrowthScene& scene, std::uint32_t i, const Midline& midline) {
  const AxisProjection at = midline.axis.view().project(testing::placeOf(scene.points[i]));
  const LocalShape& shape = scene.shapes[i];
  return growth::similarityOf({testing::placeOf(shape.direction), testing::placeOf(shape.normal),
                               shape.linearity, shape.curvature, shape.neighbors},
                              at, growth::awayOf(at, midline.spread));
}

TEST(Similarity, FallsWithDistanceFromTheSurface) {
  Points points;
  for (int k = 0; k <= 40; ++k)
    points.emplace_back(0.012F + 0.001F * static_cast<float>(k), 0, 0.5F);
  const TinyCloud cloud(points);
  const Midline midline = midlineAlong(verticalAxis(1.0F, 0.012F), 0.002F);
  float before = similarity(cloud.scene(), 0U, midline);
  EXPECT_GT(before, 0.8F) << "on the surface and shaped like a stem";
  EXPECT_LE(before, 1.0F);
  for (std::uint32_t i = 1; i < points.size(); ++i) {
    const float now = similarity(cloud.scene(), i, midline);
    EXPECT_LE(now, before) << i;
    EXPECT_GE(now, 0.0F);
    before = now;
  }
  EXPECT_LT(before, 0.05F) << "4 cm off a 12 mm stem";
}

TEST(Similarity, AskForANormalAcrossTheAxis) {
  const Points points = {{0.012F, 0.0F, 0.5F}, {-0.012F, 0.0F, 0.5F}};
  const NeighborGrid grid(points, 0.1F);
  LocalShape stem;
  stem.normal = Eigen::Vector3f::UnitX();
  stem.direction = Eigen::Vector3f::UnitZ();
  stem.linearity = 0.7F;
  LocalShape leaf = stem;  // lies flat
  leaf.normal = Eigen::Vector3f::UnitZ();
  leaf.direction = Eigen::Vector3f::UnitX();
  const Midline midline = midlineAlong(verticalAxis(1.0F, 0.012F), 0.002F);
  const std::vector<LocalShape> shapes = {stem, leaf};
  const GrowthScene scene{points, shapes, grid};
  EXPECT_GT(similarity(scene, 0U, midline), similarity(scene, 1U, midline) + 0.2F);
}

// ---------------------------------------------------------------------------- pruning

/// What is left of the members after all of them have grown.
std::vector<std::uint32_t> prune(const Points& points, const std::vector<std::uint32_t>& members,
                                 const StemAxis& axis, float factor) {
  Points some;
  for (const std::uint32_t i : members) some.push_back(points[i]);
  Midline midline = vagueMidline();
  midline.axis = axis;
  const TinyCloud cloud(some);
  GrowthSettings settings(growthParameters(0.0, 1.0));
  settings.r1 = 10.0F;
  const std::vector<GrowthRegionTask> regions{
      testing::regionTask(axis.pointAt(0.0F), axis.pointAt(axis.length()))};
  GrowthTask task = testing::growthTask(cloud.scene(), midline, regions, settings);
  task.bands = std::max(1, static_cast<int>(std::lround(axis.length() / 0.1F)));
  task.band_height = axis.length() / static_cast<float>(task.bands);
  task.prune_factor = factor;
  testing::GrowthRoom room(task);
  StemGrowth<SerialTeam>(SerialTeam(), task, room.memory, room.scratch()).growCandidate();
  std::vector<std::uint32_t> kept;
  for (int k = 0; k < room.shared.outcome.points; ++k) {
    kept.push_back(members[room.memory.best[k]]);
  }
  return kept;
}

TEST(Pruning, LikeBruteForceInOneBand) {
  std::mt19937 random(6U);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  Points points;
  for (int k = 0; k < 301; ++k) {
    points.emplace_back(0.05F * unit(random), 0.05F * unit(random), 0.045F + 0.04F * unit(random));
  }
  const StemAxis axis = verticalAxis(0.09F, 0.01F);
  std::vector<std::uint32_t> members;
  for (std::uint32_t i = 0; i < points.size(); i += 2U) members.push_back(i);
  std::vector<float> distances;
  for (const std::uint32_t i : members) distances.push_back(points[i].head<2>().norm());
  std::vector<float> sorted = distances;
  std::sort(sorted.begin(), sorted.end());
  const float median = sorted[sorted.size() / 2U];
  for (const float factor : {1.0F, 1.5F, 2.2F}) {
    std::vector<std::uint32_t> expected;
    for (std::size_t k = 0; k < members.size(); ++k) {
      if (distances[k] <= factor * median) expected.push_back(members[k]);
    }
    EXPECT_EQ(prune(points, members, axis, factor), expected) << factor;
    ASSERT_LT(factor == 1.0F ? expected.size() : 0U, members.size());
  }
}

TEST(Pruning, FollowsTheTaper) {
  // 15 mm at the soil, 5 mm at the top: one threshold for all heights would keep or lose too much.
  const StemAxis axis({{{0.0F, 0.0F, 0.0F}, 0.015F}, {{0.0F, 0.0F, 2.0F}, 0.005F}});
  Points points = surfaceOf(axis, 4000U, 0.0005, 2.0 * M_PI, 7U);
  const std::size_t stem = points.size();
  for (int k = 0; k < 100; ++k) {
    const float s = 0.05F + 0.019F * static_cast<float>(k);
    points.emplace_back(3.0F * axis.radiusAt(s), 0.0F, s);
  }
  const auto kept = prune(points, allOf(points), axis, 2.2F);
  std::size_t stem_kept = 0U;
  for (const std::uint32_t i : kept) stem_kept += i < stem ? 1U : 0U;
  EXPECT_EQ(stem_kept, stem);
  EXPECT_EQ(kept.size(), stem) << "over-segmented points are left";
  EXPECT_TRUE(std::is_sorted(kept.begin(), kept.end())) << "the order is kept";
}

TEST(Pruning, NothingToPrune) {
  EXPECT_TRUE(prune({}, {}, verticalAxis(1.0F, 0.01F), 2.0F).empty());
  const Points one = {{0.3F, 0.0F, 0.5F}};
  EXPECT_EQ(prune(one, {0U}, verticalAxis(1.0F, 0.01F), 2.0F).size(), 1U);
}

// ---------------------------------------------------------------------------- midline

struct MidlineError {
  double center = 0.0;  // largest distance between the axes [m]
  double radius = 0.0;  // largest difference [m]
};

MidlineError errorOf(const Midline& midline, const StemAxis& truth) {
  MidlineError error;
  for (float s = 0.1F; s < truth.length() - 0.1F; s += 0.05F) {
    const StemAxis::Projection at = midline.axis.project(truth.pointAt(s));
    error.center = std::max(error.center, static_cast<double>(at.distance));
    error.radius =
        std::max(error.radius, static_cast<double>(std::abs(at.radius - truth.radiusAt(s))));
  }
  return error;
}

StemAxis roughPrior(const StemAxis& truth, float offset) {
  std::vector<StemAxis::Node> nodes;
  for (float s = 0.0F; s <= truth.length(); s += 0.3F) {
    nodes.push_back({truth.pointAt(s) + Eigen::Vector3f(offset, -offset, 0.0F), 0.015F});
  }
  return StemAxis(nodes);
}

const StemAxis& maizeStem() {
  static const StemAxis axis({{{0.3F, -0.2F, 0.0F}, 0.013F},
                              {{0.31F, -0.2F, 0.4F}, 0.012F},
                              {{0.33F, -0.19F, 0.8F}, 0.011F},
                              {{0.36F, -0.18F, 1.2F}, 0.010F},
                              {{0.40F, -0.16F, 1.6F}, 0.009F}});
  return axis;
}

TEST(MidlinePruning, NothingBeyondTheStemsEnd) {
  const Points points{{0.01F, 0.0F, 0.9F}, {0.01F, 0.0F, 0.99F}, {0.01F, 0.0F, 1.02F}};
  const auto kept = prune(points, allOf(points), verticalAxis(1.0F, 0.01F), 2.2F);
  EXPECT_EQ(kept, (std::vector<std::uint32_t>{0U, 1U}));
}

TEST(Midline, WholeStemAllRound) {
  const Points points = surfaceOf(maizeStem(), 3000U, 0.002, 2.0 * M_PI, 8U);
  const Midline midline =
      fitMidline(points, allOf(points), roughPrior(maizeStem(), 0.006F), 0.03F, 2.0F);
  const MidlineError error = errorOf(midline, maizeStem());
  EXPECT_LT(error.center, 0.002);
  EXPECT_LT(error.radius, 0.0012);
  EXPECT_NEAR(midline.spread, 0.002F, 0.001F);
}

TEST(Midline, HalfSeen) {
  const Points points = surfaceOf(maizeStem(), 2500U, 0.002, M_PI, 9U);
  const Midline midline =
      fitMidline(points, allOf(points), roughPrior(maizeStem(), 0.004F), 0.03F, 2.0F);
  const MidlineError error = errorOf(midline, maizeStem());
  EXPECT_LT(error.center, 0.005);
  EXPECT_LT(error.radius, 0.004);
}

TEST(Midline, AmongLeafPointsAndWithAGap) {
  Points points;
  for (const Eigen::Vector3f& point : surfaceOf(maizeStem(), 3000U, 0.0015, 2.0 * M_PI, 10U)) {
    if (point.z() < 0.6F || point.z() > 0.85F) points.push_back(point);
  }
  std::mt19937 random(11U);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  for (const float s : {0.35F, 0.95F, 1.25F}) {  // leaves rise from the stem
    const Eigen::Vector3f insertion = maizeStem().pointAt(s);
    for (int k = 0; k < 150; ++k) {
      const float t = 0.03F * unit(random);
      points.emplace_back(insertion + Eigen::Vector3f(0.01F + t, 0.02F * unit(random), 1.5F * t));
    }
  }
  const Midline midline =
      fitMidline(points, allOf(points), roughPrior(maizeStem(), 0.005F), 0.03F, 2.0F);
  const MidlineError error = errorOf(midline, maizeStem());
  EXPECT_LT(error.center, 0.005);
  EXPECT_LT(error.radius, 0.003);
}

TEST(Midline, CarriedOnFromWhatIsKnown) {
  const Points points = surfaceOf(maizeStem(), 3000U, 0.002, M_PI, 13U);
  const StemAxis low = maizeStem().below(0.9F);
  Midline known = fitMidline(points, allOf(points), roughPrior(low, 0.004F), 0.03F, 2.0F);
  known.axis = known.axis.extendedBy(maizeStem().length() - known.axis.length());
  const float before = known.axis.project(maizeStem().pointAt(1.55F)).distance;
  const Midline midline = refitMidline(points, allOf(points), known, 0.03F, 2.0F);
  const MidlineError error = errorOf(midline, maizeStem());
  EXPECT_GT(before, 0.02F);  // straight on misses the bend
  EXPECT_LT(error.center, 0.005);
  EXPECT_LT(error.radius, 0.003);
}

TEST(Midline, TooFewPointsLeaveItAsItIsKnown) {
  Midline known;
  known.axis = maizeStem();
  known.spread = 0.004F;
  const Points points = surfaceOf(maizeStem(), 3U, 0.001, 2.0 * M_PI, 14U);
  const Midline midline = refitMidline(points, allOf(points), known, 0.03F, 2.0F);
  EXPECT_FLOAT_EQ(midline.axis.length(), maizeStem().length());
  EXPECT_FLOAT_EQ(midline.spread, 0.004F);
}

TEST(Midline, TooFewPointsGiveThePriorBack) {
  const StemAxis prior = roughPrior(maizeStem(), 0.0F);
  for (const std::size_t count : {0U, 1U, 3U}) {
    const Points points = surfaceOf(maizeStem(), count, 0.001, 2.0 * M_PI, 12U);
    const Midline midline = fitMidline(points, allOf(points), prior, 0.03F, 2.0F);
    ASSERT_FALSE(midline.axis.empty());
    for (float s = 0.0F; s < prior.length(); s += 0.2F) {
      EXPECT_LT((midline.axis.project(prior.pointAt(s))).distance, 0.001F);
    }
    EXPECT_TRUE(std::isfinite(midline.spread));
  }
}

/// A blade 2 cm wide that leaves the axis x = y = 0 at `start`, straight, `lean` from vertical.
void addBlade(Points& points, float start, float length, float lean, float azimuth, int count,
              unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  const Eigen::Vector3f out(std::cos(azimuth), std::sin(azimuth), 0.0F);
  const Eigen::Vector3f side(-out.y(), out.x(), 0.0F);
  for (int k = 0; k < count; ++k) {
    const float t = length * unit(random);
    points.emplace_back((0.005F + t * std::sin(lean)) * out + 0.02F * (unit(random) - 0.5F) * side +
                        Eigen::Vector3f(0.0F, 0.0F, start + t * std::cos(lean)));
  }
}

TEST(Midline, SeedlingWhoseLeavesShowMoreThanItsStem) {
  for (const unsigned seed : {31U, 32U, 33U}) {
    const StemAxis stem = verticalAxis(0.16F, 0.005F);
    Points points = surfaceOf(stem, 90U, 0.002, 2.0 * M_PI, seed);
    addBlade(points, 0.06F, 0.15F, 0.8F, 1.0F, 60, seed);
    addBlade(points, 0.12F, 0.25F, 0.35F, 4.1F, 120, seed + 10U);
    addBlade(points, 0.16F, 0.25F, 0.25F, 1.0F, 150, seed + 20U);
    // The prior follows the highest leaf, and misses the foot.
    const StemAxis prior({{{-0.02F, -0.03F, 0.0F}, 0.015F}, {{0.03F, 0.045F, 0.40F}, 0.015F}});
    const Midline midline = fitMidline(points, allOf(points), prior, 0.03F, 0.4F);
    for (const float z : {0.02F, 0.06F, 0.10F}) {
      const StemAxis::Projection at = midline.axis.project({0.0F, 0.0F, z});
      EXPECT_LT(at.distance, 0.006F) << "seed " << seed << ", height " << z;
      EXPECT_LT(at.radius, 0.008F) << "seed " << seed << ", height " << z;
    }
  }
}

/// A young stem, 0.7 m long, that loses 0.42 of its radius; steep leaves clasp its upper half.
StemAxis youngStem() {
  return StemAxis({{{0.0F, 0.0F, 0.0F}, 0.010F}, {{0.0F, 0.0F, 0.7F}, 0.0058F}});
}

TEST(MidlineRefinement, LeavesThatClaspDoNotDrawAYoungStem) {
  for (const unsigned seed : {41U, 42U, 43U}) {
    Points points = surfaceOf(youngStem(), 220U, 0.002, 2.0 * M_PI, seed);
    addBlade(points, 0.35F, 0.6F, 0.30F, 1.0F, 150, seed);
    addBlade(points, 0.50F, 0.5F, 0.20F, 1.3F, 250, seed + 10U);
    addBlade(points, 0.60F, 0.5F, 0.15F, 0.8F, 300, seed + 20U);
    // What leaves have drawn: too thick, and aside in the whorl.
    Midline drawn;
    drawn.axis = StemAxis({{{0.0F, 0.0F, 0.0F}, 0.011F},
                           {{0.001F, 0.001F, 0.35F}, 0.0105F},
                           {{0.007F, 0.009F, 0.7F}, 0.010F}});
    drawn.spread = 0.003F;
    const Midline refined = refineMidline(points, allOf(points), drawn, 1.2F, 1.2);
    EXPECT_NEAR(refined.axis.length(), 0.7F, 0.01F);
    for (float z = 0.0F; z < 0.66F; z += 0.05F) {
      const StemAxis::Projection at = refined.axis.project({0.0F, 0.0F, z});
      EXPECT_LT(at.distance, 0.003F) << "seed " << seed << ", height " << z;
      EXPECT_NEAR(at.radius, youngStem().radiusAt(z), 0.0015F) << "seed " << seed << ", " << z;
    }
    EXPECT_NEAR(refined.spread, 0.0026F, 0.0005F);
  }
}

TEST(MidlineRefinement, AHiddenFootStaysWhereItWas) {
  Points points;
  for (const Eigen::Vector3f& point : surfaceOf(youngStem(), 400U, 0.003, 2.0 * M_PI, 44U)) {
    if (point.z() > 0.3F) points.push_back(point);
  }
  const Midline midline = midlineAlong(youngStem(), 0.003F);
  const Midline refined = refineMidline(points, allOf(points), midline, 2.0F);
  EXPECT_LT(refined.axis.project({0.0F, 0.0F, 0.0F}).distance, 0.006F);
}

TEST(MidlineRefinement, TooFewPointsChangeNothing) {
  const Midline midline = midlineAlong(youngStem(), 0.003F);
  for (const std::size_t count : {0U, 1U, 10U}) {
    const Points points = surfaceOf(youngStem(), count, 0.001, 2.0 * M_PI, 45U);
    const Midline refined = refineMidline(points, allOf(points), midline, 1.2F);
    EXPECT_EQ(refined.axis.length(), midline.axis.length());
    EXPECT_EQ(refined.spread, midline.spread);
  }
}

// ---------------------------------------------------------------------------- top

/// Adds thin straight branches that start on the axis x = y = 0 and lean outwards all round.
void addBranches(Points& points, float from, float to, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  std::normal_distribution<float> noise(0.0F, 0.0015F);
  for (int branch = 0; branch < count; ++branch) {
    const float azimuth =
        6.28F * (static_cast<float>(branch) + unit(random)) / static_cast<float>(count);
    const float start = from + (to - from) * static_cast<float>(branch) / static_cast<float>(count);
    const float lean = 0.35F + 0.4F * unit(random);
    for (float t = 0.0F; t < 0.15F; t += 0.005F) {
      points.emplace_back(t * std::sin(lean) * std::cos(azimuth) + noise(random),
                          t * std::sin(lean) * std::sin(azimuth) + noise(random),
                          start + t * std::cos(lean) + noise(random));
    }
  }
}

TEST(StemTop, BelowTheTasselsBranches) {
  // A stem of 1.2 m; above it the spike goes straight on for 0.35 m and branches leave all round.
  for (const unsigned seed : {13U, 14U, 15U}) {
    Points points = surfaceOf(verticalAxis(1.2F, 0.009F), 1000U, 0.002, 2.0 * M_PI, seed);
    const StemAxis spike({{{0.0F, 0.0F, 1.2F}, 0.004F}, {{0.0F, 0.0F, 1.55F}, 0.002F}});
    for (const Eigen::Vector3f& point : surfaceOf(spike, 200U, 0.002, 2.0 * M_PI, seed)) {
      points.push_back(point);
    }
    addBranches(points, 1.2F, 1.3F, 9, seed);
    const Midline midline = midlineAlong(verticalAxis(1.6F, 0.009F), 0.002F);
    EXPECT_NEAR(findStemTop(points, allOf(points), midline), 1.2F, 0.03F) << "seed " << seed;
  }
}

TEST(StemTop, WhereTheWhorlOpens) {
  // No tassel: above the stem leaves lean away from its axis, so that nothing is left on it.
  for (const unsigned seed : {16U, 17U, 18U}) {
    Points points = surfaceOf(verticalAxis(0.7F, 0.01F), 600U, 0.002, 2.0 * M_PI, seed);
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
    for (int k = 0; k < 900; ++k) {  // two opposite blades, 6 cm wide
      const float t = 0.25F * (1.0F + unit(random));
      const float side = k % 2 == 0 ? 1.0F : -1.0F;
      points.emplace_back(side * (0.01F + 0.25F * t), 0.03F * unit(random), 0.68F + t);
    }
    const Midline midline = midlineAlong(verticalAxis(1.1F, 0.01F), 0.002F);
    EXPECT_NEAR(findStemTop(points, allOf(points), midline), 0.7F, 0.06F) << "seed " << seed;
  }
}

TEST(StemTop, WhereLeavesBesideTheAxisExplainWhatIsOnIt) {
  // Above the stem a few points of leaves are left on the axis, and many stand close beside it.
  for (const unsigned seed : {19U, 20U, 21U}) {
    Points points = surfaceOf(verticalAxis(0.7F, 0.01F), 600U, 0.002, 2.0 * M_PI, seed);
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> unit(0.0F, 1.0F);
    for (int k = 0; k < 900; ++k) {
      const float angle = 6.2832F * unit(random);
      const float distance = k % 12 == 0 ? 0.01F * unit(random) : 0.015F + 0.01F * unit(random);
      points.emplace_back(distance * std::cos(angle), distance * std::sin(angle),
                          0.7F + 0.4F * unit(random));
    }
    const Midline midline = midlineAlong(verticalAxis(1.1F, 0.01F), 0.002F);
    EXPECT_NEAR(findStemTop(points, allOf(points), midline), 0.7F, 0.08F) << "seed " << seed;
    EXPECT_GT(findStemTop(points, allOf(points), midline, {}, {}, 0.0), 0.9F) << "seed " << seed;
  }
}

TEST(StemTop, LeavesAllRoundAnOpenWhorlAreNoTassel) {
  // The last leaves come out of the stem all round above a bare stretch, as a tassel's branches do.
  for (const unsigned seed : {21U, 22U, 23U}) {
    Points points = surfaceOf(verticalAxis(0.7F, 0.01F), 600U, 0.002, 2.0 * M_PI, seed);
    for (int leaf = 0; leaf < 6; ++leaf) {
      const auto k = static_cast<float>(leaf);
      addBlade(points, 0.54F + 0.03F * k, 0.5F, 0.25F, 2.4F * k, 250,
               seed + 10U * static_cast<unsigned>(leaf));
    }
    const Midline midline = midlineAlong(verticalAxis(1.0F, 0.01F), 0.002F);
    EXPECT_NEAR(findStemTop(points, allOf(points), midline), 0.7F, 0.07F) << "seed " << seed;
  }
}

TEST(StemTop, NotAtAnEar) {
  // An ear half way up bursts out of the stem as a tassel does, but leaves and stem go on above it.
  Points points = surfaceOf(verticalAxis(1.6F, 0.01F), 1600U, 0.002, 2.0 * M_PI, 19U);
  addBranches(points, 1.1F, 1.15F, 9, 19U);
  addBranches(points, 1.4F, 1.45F, 9, 20U);
  const Midline midline = midlineAlong(verticalAxis(1.6F, 0.01F), 0.002F);
  EXPECT_GT(findStemTop(points, allOf(points), midline), 1.35F);
}

/// An axis of 1.6 m, of which less is a stem.
Midline axisThatRunsOn() {
  return midlineAlong(verticalAxis(1.6F, 0.009F), 0.002F);
}

TEST(StemTop, AsTheStandsWhereTheTasselShowsOnOneSideOnly) {
  // Branches seen from one side: alone, the axis ends with the spike.
  Points points = surfaceOf(verticalAxis(1.55F, 0.009F), 1400U, 0.002, 2.0 * M_PI, 24U);
  addBranches(points, 1.2F, 1.3F, 2, 24U);
  const Midline midline = axisThatRunsOn();
  EXPECT_GT(findStemTop(points, allOf(points), midline), 1.5F);
  const StandLength stand{1.22, 0.05, 0.3, 0.1};
  EXPECT_NEAR(findStemTop(points, allOf(points), midline, {}, stand), 1.2F, 0.05F);
}

TEST(StemTop, NotAtLeavesAllRoundWhereNoStemOfTheStandEnds) {
  // As there, but leaves leave the stem all round lower down, as a tassel's branches do.
  Points points = surfaceOf(verticalAxis(1.55F, 0.009F), 1400U, 0.002, 2.0 * M_PI, 26U);
  addBranches(points, 0.97F, 1.03F, 7, 26U);
  addBranches(points, 1.2F, 1.3F, 2, 27U);
  const Midline midline = axisThatRunsOn();
  EXPECT_NEAR(findStemTop(points, allOf(points), midline), 0.97F, 0.05F);
  const StandLength stand{1.22, 0.05, 0.3, 0.1};
  EXPECT_NEAR(findStemTop(points, allOf(points), midline, {}, stand), 1.2F, 0.05F);
}

TEST(StemTop, ShortStemsOfATallStandStayShort) {
  Points points = surfaceOf(verticalAxis(0.9F, 0.009F), 900U, 0.002, 2.0 * M_PI, 25U);
  const Midline midline = axisThatRunsOn();
  const StandLength stand{1.5, 0.06, 0.3, 0.1};
  EXPECT_NEAR(findStemTop(points, allOf(points), midline, {}, stand), 0.9F, 0.06F);
}

/// Above 1.4 m every 25 cm half as many points are left.
SamplingProfile halvedEvery25Centimetres(double canopy) {
  std::vector<float> heights;
  std::vector<LocalShape> shapes;
  for (int k = 0; k < 2600; ++k) {
    heights.push_back(0.001F * static_cast<float>(k));
    shapes.emplace_back();
    shapes.back().neighbors =
        1U + static_cast<std::uint32_t>(200.0F *
                                        std::exp2(-std::max(0.0F, heights.back() - 1.4F) / 0.25F));
  }
  return {heights, shapes, canopy};
}

/// A stem of 2.3 m with a share of its points left that depends on the height.
template <class Share>
Points thinnedStem(const Share& shareAt, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  Points points;
  for (const Eigen::Vector3f& point :
       surfaceOf(verticalAxis(2.3F, 0.011F), 2000U, 0.002, 2.0 * M_PI, seed)) {
    if (unit(random) < shareAt(static_cast<double>(point.z()))) points.push_back(point);
  }
  return points;
}

/// Its axis, which runs on.
Midline axisOfThinnedStem() {
  return midlineAlong(verticalAxis(2.6F, 0.011F), 0.002F);
}

TEST(StemTop, WherePlantsAreTallerThanCanBeSeenWell) {
  const SamplingProfile sampling = halvedEvery25Centimetres(0.0);
  const Midline midline = axisOfThinnedStem();
  int found = 0;
  for (const unsigned seed : {28U, 29U, 30U, 31U, 32U}) {
    const Points points = thinnedStem([&](double height) { return sampling.at(height); }, seed);
    const std::vector<std::uint32_t> members = allOf(points);
    EXPECT_NEAR(findOccupiedEnd(points, members, midline, sampling), 2.3F, 0.1F);
    if (findOccupiedEnd(points, members, midline) > 2.2F) ++found;
  }
  EXPECT_EQ(found, 0) << "without the profile the end looks empty";
}

TEST(StemTop, WhereLeavesHideStemsFromLowerDownThanTheyThinOut) {
  const double hidden = 0.6;  // [m] of 5 m
  const SamplingProfile of_leaves = halvedEvery25Centimetres(0.0);
  const SamplingProfile sampling = halvedEvery25Centimetres(5.0);
  const Midline midline = axisOfThinnedStem();
  int found = 0;
  int found_as_leaves = 0;
  for (unsigned seed = 40U; seed < 60U; ++seed) {
    const Points points =
        thinnedStem([&](double height) { return of_leaves.at(height + hidden); }, seed);
    const std::vector<std::uint32_t> members = allOf(points);
    const auto isFound = [&](const SamplingProfile& profile) {
      return std::abs(findOccupiedEnd(points, members, midline, profile) - 2.3F) < 0.1F;
    };
    if (isFound(sampling)) ++found;
    if (isFound(of_leaves)) ++found_as_leaves;
  }
  EXPECT_GE(found, 18);
  EXPECT_LE(found_as_leaves, 15);
}

TEST(StemTop, WhereNothingEndsIt) {
  const Midline midline = midlineAlong(maizeStem(), 0.0015F);
  const Points points = surfaceOf(maizeStem(), 2000U, 0.0015, 2.0 * M_PI, 16U);
  EXPECT_NEAR(findStemTop(points, allOf(points), midline), maizeStem().length(), 0.051F)
      << "to one band";
  EXPECT_NEAR(findStemTop({}, {}, midline), maizeStem().length(), 1e-5F);
}

}  // namespace
}  // namespace field_phenotyping
