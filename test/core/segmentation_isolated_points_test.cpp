// Points that were taken out as outliers, given back to stems and plants.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <random>
#include <vector>

#include "field_phenotyping/preprocessing/preprocessor.hpp"
#include "field_phenotyping/segmentation/isolated_points.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::exactGround;
using testing::kDegree;
using testing::PlantTruth;
using testing::Scene;

/// Five sparse stems without leaves, 0.3 m apart; every third of their points was taken out.
struct SparseField {
  Block block;
  std::vector<StemAxis> axes;
  PointOwners known;                // of block.cloud
  std::vector<std::int32_t> truth;  // of block.isolated

  void addIsolated(const Eigen::Vector3d& point, std::int32_t plant) {
    block.isolated.points.push_back(point.cast<float>());
    truth.push_back(plant);
  }

  void addOrgan(const Eigen::Vector3d& point, std::int32_t plant) {
    block.cloud.points.push_back(point.cast<float>());
    known.stem.push_back(-1);
    known.plant.push_back(plant);
  }

  PointOwners find() const {
    return findIsolatedPoints(block, NeighborGrid(block.cloud.points, 0.03F), axes, known);
  }
};

SparseField sparseField(double lean, double noise, std::uint32_t seed) {
  SparseField field;
  Scene scene(testing::levelSoil(), seed, noise);
  field.block.ground = exactGround(testing::levelSoil());
  for (int k = 0; k < 5; ++k) {
    PlantTruth plant;
    plant.base = {0.3 * k, 0.0};
    plant.stem_length = 1.2;
    plant.leaves = 0;
    plant.lean = lean;
    plant.azimuth = 1.0 + k;
    plant.stem_points_per_metre = 50;
    scene.addPlant(plant);
    const Eigen::Vector3d base = scene.baseOf(plant);
    const Eigen::Vector3d up(std::sin(lean) * std::cos(plant.azimuth),
                             std::sin(lean) * std::sin(plant.azimuth), std::cos(lean));
    const auto radius = static_cast<float>(plant.radius);
    // What is known of a stem begins somewhat above the soil.
    field.axes.emplace_back(std::vector<StemAxis::Node>{{(base + 0.2 * up).cast<float>(), radius},
                                                        {(base + 1.2 * up).cast<float>(), radius}});
  }
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    const Eigen::Vector3f& p = scene.cloud.points[i];
    if (i % 3U == 0U) {
      field.addIsolated(p.cast<double>(), scene.truth[i].plant);
    } else {
      field.block.cloud.points.push_back(p);
      field.known.stem.push_back(scene.truth[i].plant);
      field.known.plant.push_back(-1);
    }
  }
  return field;
}

/// Dust over the field and beside it, `density` points to a cubic metre.
void addDust(SparseField& field, double density, std::uint32_t seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<double> x(-0.5, 1.7), y(-0.5, 0.5), z(0.05, 2.0);
  const int count = static_cast<int>(density * 2.2 * 1.0 * 1.95);
  for (int i = 0; i < count; ++i) field.addIsolated({x(engine), y(engine), z(engine)}, -1);
}

TEST(IsolatedPoints, OfStemsComeBackToThem) {
  for (const double lean : {0.0, 15.0 * kDegree}) {
    for (const double noise : {0.002, 0.006}) {
      const SparseField field = sparseField(lean, noise, 11U);
      const PointOwners found = field.find();
      ASSERT_EQ(found.stem.size(), field.truth.size());
      double right = 0.0;
      for (std::size_t i = 0; i < field.truth.size(); ++i) {
        if (found.stem[i] < 0) continue;
        EXPECT_EQ(found.stem[i], field.truth[i]);
        EXPECT_EQ(found.plant[i], field.truth[i]);
        right += 1.0;
      }
      EXPECT_GT(right / static_cast<double>(field.truth.size()), 0.9) << lean << ' ' << noise;
    }
  }
}

TEST(IsolatedPoints, OffTheSurfaceOrAmongLeavesAreNoStemPoints) {
  SparseField field = sparseField(0.0, 0.002, 12U);
  const std::size_t begin = field.truth.size();
  for (double z = 0.3; z < 1.1; z += 0.1) {
    field.addIsolated({0.025, 0.0, z}, 0);
    field.addIsolated({0.3, -0.03, z}, 1);
  }
  PointOwners found = field.find();
  for (std::size_t i = begin; i < field.truth.size(); ++i) EXPECT_LT(found.stem[i], 0) << i;

  SparseField leafy = sparseField(0.0, 0.002, 12U);
  std::mt19937 engine(3U);
  std::uniform_real_distribution<double> across(-0.1, 0.1), up(0.2, 1.2);
  for (int i = 0; i < 12000; ++i) leafy.addOrgan({across(engine), across(engine), up(engine)}, 0);
  const PointOwners among = leafy.find();
  const auto ofFirst = [&](const PointOwners& owners) {
    return std::count(owners.stem.begin(), owners.stem.end(), 0);
  };
  EXPECT_LT(ofFirst(among), ofFirst(found) / 2);
}

TEST(IsolatedPoints, SparseTipsBelongToThePlantBelowThem) {
  SparseField field = sparseField(0.0, 0.002, 13U);
  const std::size_t begin = field.truth.size();
  for (std::int32_t k = 0; k < 5; ++k) {
    for (const double above : {0.06, 0.14, 0.22})
      field.addIsolated({0.3 * k + 0.01, 0.0, 1.2 + above}, k);
  }
  const PointOwners found = field.find();
  for (std::size_t i = begin; i < field.truth.size(); ++i) {
    EXPECT_EQ(found.plant[i], field.truth[i]) << i;
    EXPECT_LT(found.stem[i], 0) << i;
  }
}

TEST(IsolatedPoints, NoPlantGrowsByDust) {
  SparseField field = sparseField(0.0, 0.002, 14U);
  field.block.isolated = {};
  field.truth.clear();
  addDust(field, 300.0, 5U);
  const PointOwners found = field.find();
  const auto given = static_cast<std::size_t>(
      std::count_if(found.plant.begin(), found.plant.end(), [](std::int32_t p) { return p >= 0; }));
  EXPECT_LT(given, found.plant.size() / 100U) << "but for what lies right on a stem";
}

TEST(IsolatedPoints, NoneWhereThereIsNothing) {
  SparseField field = sparseField(0.0, 0.002, 15U);
  const std::vector<std::int32_t> none(field.truth.size(), -1);
  field.axes.clear();
  field.known.stem.assign(field.known.stem.size(), -1);
  EXPECT_EQ(field.find().stem, none);
  EXPECT_EQ(field.find().plant, none);
  field.block.isolated = {};
  EXPECT_TRUE(field.find().plant.empty());
}

TEST(IsolatedPoints, AreTheOutliersAboveTheSoil) {
  Scene scene(testing::levelSoil(), 16U, 0.002);
  scene.addSoil({-1.0, -1.0}, {1.0, 1.0}, 4000.0, 0.003);
  PlantTruth plant;
  plant.stem_points_per_metre = 1500;
  scene.addPlant(plant);
  BlockPoints points;
  points.cloud = scene.cloud;
  const Eigen::Vector3f alone(0.6F, 0.6F, 1.0F), below(0.6F, -0.6F, -0.3F);
  points.cloud.points.push_back(alone);
  points.cloud.points.push_back(below);
  const Block block = finishBlock(points, {});
  const std::vector<Eigen::Vector3f>& isolated = block.isolated.points;
  EXPECT_EQ(std::count(isolated.begin(), isolated.end(), alone), 1);
  EXPECT_EQ(std::count(isolated.begin(), isolated.end(), below), 0);
  EXPECT_LT(isolated.size(), 20U);
}

}  // namespace
}  // namespace field_phenotyping
