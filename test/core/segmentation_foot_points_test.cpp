// The lowest points of stems, found among the soil that was taken out beside them.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <vector>

#include "field_phenotyping/preprocessing/ground_estimation.hpp"
#include "field_phenotyping/segmentation/foot_points.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::exactGround;
using testing::kDegree;
using testing::PlantTruth;
using testing::Scene;
using testing::Soil;

/// Six stems without leaves on soil, cut at the height that soil is taken out to.
struct CutField {
  Scene scene;
  Block block;
  std::vector<StemAxis> axes;
  std::vector<std::int32_t> owner;     // of the points above the cut
  std::vector<std::size_t> feet_from;  // in the scene, of each point of block.feet
};

bool isUnderAStem(const Scene& scene, const Eigen::Vector3f& point) {
  return std::any_of(scene.plants.begin(), scene.plants.end(), [&](const PlantTruth& plant) {
    return (point.head<2>().cast<double>() - plant.base).norm() < plant.radius;
  });
}

CutField cutField(const Soil& soil, double noise, double roughness, int points_per_metre,
                  double lean = 0.0) {
  constexpr float kCut = 0.025F;
  CutField field{Scene(soil, 7U, noise), {}, {}, {}, {}};
  const double density = 20.0 * points_per_metre;  // of the soil [1/m^2]
  field.scene.addSoil({-1.0, -0.3}, {1.0, 0.3}, density, roughness);
  for (int k = 0; k < 6; ++k) {
    PlantTruth plant;
    plant.base = {-0.75 + 0.3 * k, 0.02 * (k % 3)};
    plant.stem_length = 0.5;
    plant.radius = 0.008 + 0.001 * k;
    plant.leaves = 0;
    plant.lean = lean;
    plant.azimuth = k;
    plant.stem_points_per_metre = points_per_metre;
    field.scene.addPlant(plant);
    const Eigen::Vector3d base = field.scene.baseOf(plant);
    const Eigen::Vector3d up(std::sin(lean) * std::cos(plant.azimuth),
                             std::sin(lean) * std::sin(plant.azimuth), std::cos(lean));
    const auto radius = static_cast<float>(plant.radius);
    field.axes.emplace_back(std::vector<StemAxis::Node>{{(base + 0.05 * up).cast<float>(), radius},
                                                        {(base + 0.5 * up).cast<float>(), radius}});
  }
  field.block.ground = exactGround(soil);
  for (std::size_t i = 0; i < field.scene.cloud.size(); ++i) {
    const Eigen::Vector3f& p = field.scene.cloud.points[i];
    if (field.scene.truth[i].soil && isUnderAStem(field.scene, p)) continue;
    if (field.block.ground.heightAbove(p) < kCut) {
      field.block.feet.points.push_back(p);
      field.feet_from.push_back(i);
    } else {
      field.block.cloud.points.push_back(p);
      field.owner.push_back(field.scene.truth[i].plant);
    }
  }
  return field;
}

struct FootScore {
  double found = 0.0;  // share of the stems' points from 3 mm above the soil on
  double wrong = 0.0;  // soil points taken, for each such point
  int of_another = 0;  // points given to another stem
};

FootScore scoreFeet(const CutField& field) {
  const std::vector<std::int32_t> given = findFootPoints(field.block, field.axes, field.owner);
  FootScore score;
  double all = 0.0, found = 0.0, wrong = 0.0;
  for (std::size_t i = 0; i < given.size(); ++i) {
    const testing::PointTruth& truth = field.scene.truth[field.feet_from[i]];
    if (truth.soil) {
      wrong += given[i] >= 0 ? 1.0 : 0.0;
    } else if (field.block.ground.heightAbove(field.block.feet.points[i]) > 0.003F) {
      all += 1.0;
      found += given[i] == truth.plant ? 1.0 : 0.0;
      score.of_another += given[i] >= 0 && given[i] != truth.plant ? 1 : 0;
    }
  }
  score.found = found / all;
  score.wrong = wrong / all;
  return score;
}

TEST(FootPoints, AreFoundDownToTheSoil) {
  const FootScore score = scoreFeet(cutField(testing::levelSoil(), 0.002, 0.003, 1500));
  EXPECT_GT(score.found, 0.95);
  EXPECT_LT(score.wrong, 0.05);
  EXPECT_EQ(score.of_another, 0);
}

TEST(FootPoints, OfLeaningStemsOnASlope) {
  const FootScore score =
      scoreFeet(cutField(testing::slopingSoil(10.0, 30.0), 0.002, 0.003, 1500, 12.0 * kDegree));
  EXPECT_GT(score.found, 0.93);
  EXPECT_LT(score.wrong, 0.07);
}

TEST(FootPoints, InNoiseOnlyWhatTheSoilDoesNotExplainAsWell) {
  const FootScore score = scoreFeet(cutField(testing::levelSoil(), 0.008, 0.008, 1500));
  EXPECT_GT(score.found, 0.2);
  EXPECT_LT(score.wrong, 0.35);
}

TEST(FootPoints, OfSparseStems) {
  const FootScore score = scoreFeet(cutField(testing::levelSoil(), 0.002, 0.003, 120));
  EXPECT_GT(score.found, 0.8);
  EXPECT_LT(score.wrong, 0.3);
}

TEST(FootPoints, NoneWhereNothingIsKnownOfAStem) {
  CutField field = cutField(testing::levelSoil(), 0.002, 0.003, 1500);
  const std::vector<std::int32_t> none(field.feet_from.size(), -1);
  field.owner.assign(field.owner.size(), -1);
  EXPECT_EQ(findFootPoints(field.block, {}, field.owner), none);
  EXPECT_EQ(findFootPoints(field.block, field.axes, field.owner), none);
  field.block.feet = {};
  EXPECT_TRUE(findFootPoints(field.block, field.axes, field.owner).empty());
}

TEST(FootPoints, SoilBesideWhatStandsThereIsKept) {
  const CutField field = cutField(testing::levelSoil(), 0.002, 0.003, 1500);
  const GroundModel ground = exactGround(testing::levelSoil());
  std::vector<std::uint8_t> is_ground;
  for (const Eigen::Vector3f& p : field.scene.cloud.points)
    is_ground.push_back(p.z() < 0.025F ? 1U : 0U);
  const auto kept = soilAtFeet(field.scene.cloud, ground, is_ground);
  ASSERT_EQ(kept.size(), is_ground.size());
  constexpr double kBeside = 0.03, kFar = 0.06;  // [m] from the axis
  for (std::size_t i = 0; i < kept.size(); ++i) {
    const Eigen::Vector2d place = field.scene.cloud.points[i].head<2>().cast<double>();
    double nearest = 1.0;
    for (const PlantTruth& plant : field.scene.plants)
      nearest = std::min(nearest, (place - plant.base).norm());
    if (is_ground[i] == 0U || nearest > kFar) {
      EXPECT_EQ(kept[i], 0U);
    } else if (nearest < kBeside) {
      EXPECT_EQ(kept[i], 1U);
    }
  }
}

}  // namespace
}  // namespace field_phenotyping
