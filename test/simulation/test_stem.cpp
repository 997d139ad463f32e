#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "simulation/random.hpp"
#include "simulation/stem.hpp"

namespace field_phenotyping::simulation {
namespace {

Stem curvedStem() {
  Stem stem;
  stem.base = {1.0, -2.0, 0.3};
  stem.height = 1.7;
  stem.slope = {0.05, -0.03};
  stem.bow = {0.01, 0.004};
  stem.wave = {0.002, -0.001};
  stem.reference_semi_major = 0.011;
  stem.reference_height = 0.68;
  stem.axis_ratio = 0.85;
  stem.major_azimuth = 0.7;
  stem.nodes = {{0.2, 0.05}, {0.35, 0.07}, {0.9, 0.04}};
  return stem;
}

/// Distance of a point to the surface by search, refined round the best sample.
double bruteForceDistance(const Stem& stem, const Eigen::Vector3d& point) {
  double best = 1e9;
  double best_h = 0.0;
  double best_angle = 0.0;
  double step_h = 0.02;
  double step_angle = 0.1;
  for (int level = 0; level < 8; ++level) {
    const double centre_h = level == 0 ? point.z() - stem.base.z() : best_h;
    const double centre_angle = level == 0 ? 0.0 : best_angle;
    const int range_angle = level == 0 ? 32 : 6;
    for (int i = -6; i <= 6; ++i) {
      for (int j = -range_angle; j <= range_angle; ++j) {
        const double h = centre_h + step_h * i;
        const double angle = centre_angle + step_angle * j;
        const double distance = (stem.surfacePoint(h, angle) - point).norm();
        if (distance < best) {
          best = distance;
          best_h = h;
          best_angle = angle;
        }
      }
    }
    step_h /= 4.0;
    step_angle /= 4.0;
  }
  return best;
}

TEST(Stem, SurfacePointsLieOnTheSurface) {
  const Stem stem = curvedStem();
  for (double h = 0.01; h < 1.69; h += 0.013) {
    for (double angle = 0.0; angle < 6.2; angle += 0.37) {
      EXPECT_NEAR(stem.signedDistance(stem.surfacePoint(h, angle)), 0.0, 1e-8);
    }
  }
}

TEST(Stem, SignedDistanceAgreesWithSearch) {
  const Stem stem = curvedStem();
  RandomStream random(7, Stream::kPlant, 0);
  for (int i = 0; i < 200; ++i) {
    const double h = random.uniform(0.05, 1.6);
    const Eigen::Vector3d point =
        stem.axisPoint(h) +
        Eigen::Vector3d(random.uniform(-0.03, 0.03), random.uniform(-0.03, 0.03), 0.0);
    EXPECT_NEAR(std::abs(stem.signedDistance(point)), bruteForceDistance(stem, point), 2e-4);
  }
}

TEST(Stem, SignIsNegativeInside) {
  const Stem stem = curvedStem();
  EXPECT_LT(stem.signedDistance(stem.axisPoint(0.7)), -0.008);
  EXPECT_GT(stem.signedDistance(stem.axisPoint(0.7) + Eigen::Vector3d(0.02, 0.0, 0.0)), 0.005);
}

TEST(Stem, DiametersAreThoseDrawn) {
  const Stem stem = curvedStem();
  EXPECT_NEAR(stem.smoothSemiMajor(0.68), 0.011, 1e-12);
  EXPECT_NEAR((stem.surfacePoint(0.68, 0.0) - stem.surfacePoint(0.68, M_PI)).norm(), 0.022, 1e-9);
  EXPECT_NEAR((stem.surfacePoint(0.68, M_PI_2) - stem.surfacePoint(0.68, -M_PI_2)).norm(),
              0.85 * 0.022, 1e-9);
  EXPECT_NEAR(stem.semiMajor(0.9) / stem.smoothSemiMajor(0.9), 1.04, 1e-6);
  EXPECT_GT(stem.smoothSemiMajor(0.1), stem.smoothSemiMajor(1.6));
}

TEST(Stem, ChordHasTheLeanThatWasDrawn) {
  const Stem stem = curvedStem();
  const Eigen::Vector3d chord = stem.chordDirection();
  EXPECT_NEAR(chord.x() / chord.z(), 0.05, 1e-12);
  EXPECT_NEAR(chord.y() / chord.z(), -0.03, 1e-12);
}

TEST(Stem, LengthIsThatOfTheAxis) {
  const Stem stem = curvedStem();
  double polyline = 0.0;
  for (int i = 0; i < 5000; ++i) {
    polyline += (stem.axisPoint(1.7 * (i + 1) / 5000) - stem.axisPoint(1.7 * i / 5000)).norm();
  }
  EXPECT_NEAR(stem.length(), polyline, 1e-5);
}

TEST(Stem, MeshStaysWithinThreeHundredthsOfAMillimetre) {
  const Stem stem = curvedStem();
  TriangleMesh mesh;
  mesh.beginSurface({0, Part::kStem, 0.5F});
  addStemMesh(stem, mesh);
  double largest = 0.0;
  for (const auto& triangle : mesh.triangles) {
    const Eigen::Vector3d centre =
        (mesh.vertices[triangle[0]] + mesh.vertices[triangle[1]] + mesh.vertices[triangle[2]])
            .cast<double>() /
        3.0;
    if (centre.z() > stem.base.z()) {
      largest = std::max(largest, std::abs(stem.signedDistance(centre)));
    }
  }
  EXPECT_LT(largest, 1e-4);  // at nodes; 0.03 mm elsewhere
}

TEST(Stem, SamplesAreSpacedAsAsked) {
  const Stem stem = curvedStem();
  std::vector<Eigen::Vector3d> normals;
  const auto points = sampleStemSurface(stem, 0.002, normals);
  ASSERT_EQ(points.size(), normals.size());
  const double area = M_PI * 2.0 * 0.0093 * stem.length();
  EXPECT_NEAR(static_cast<double>(points.size()) * 0.002 * 0.002 / area, 1.0, 0.1);
  for (std::size_t i = 0; i < points.size(); i += 101) {
    EXPECT_NEAR(stem.signedDistance(points[i]), 0.0, 1e-6);
    EXPECT_GT(stem.signedDistance(points[i] + 0.002 * normals[i]), 0.0019);
    EXPECT_GE(points[i].z(), stem.base.z() - 0.002);
  }
}

TEST(DiameterHeight, IsAShareOfShortStems) {
  EXPECT_DOUBLE_EQ(diameterHeight(2.0, 0.7), 0.7);
  EXPECT_DOUBLE_EQ(diameterHeight(0.5, 0.7), 0.2);
}

}  // namespace
}  // namespace field_phenotyping::simulation
