// Whole blocks of synthetic plants, whose every point is known: seeds, stems, organs.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>
#include <random>
#include <set>

#include "field_phenotyping/segmentation/organ_assignment.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::BaseMatches;
using testing::basesOf;
using testing::blockOf;
using testing::kDegree;
using testing::matchBases;
using testing::PlantTruth;
using testing::Scene;
using testing::scoreStems;
using testing::Soil;
using testing::StemScore;

/// What segmentBlock() made of a scene.
struct Outcome {
  SegmentedBlock block;
  BaseMatches matches;
  std::size_t missed = 0U;
  std::size_t false_plants = 0U;
  StemScore stems;
  double plant_accuracy = 0.0;  // share of plant points given to the right plant
};

Outcome segment(const Scene& scene, const Soil& soil,
                const SegmentationParameters& parameters = {}) {
  std::vector<std::size_t> source;
  const Block block = blockOf(scene, soil, &source);
  Outcome outcome;
  outcome.block = segmentBlock(block, parameters);
  outcome.matches = matchBases(basesOf(scene), basesOf(outcome.block));
  outcome.missed = scene.plants.size() - outcome.matches.pairs.size();
  outcome.false_plants = outcome.block.plants.size() - outcome.matches.pairs.size();

  std::vector<int> truth_of(outcome.block.plants.size(), -2);  // -2: a plant that is none
  for (const auto& [truth, found] : outcome.matches.pairs) {
    truth_of[found] = static_cast<int>(truth);
  }
  std::vector<bool> truly(source.size());
  std::vector<bool> claimed(source.size(), false);
  std::vector<int> given(source.size(), -1);
  for (std::size_t i = 0; i < source.size(); ++i) truly[i] = scene.truth[source[i]].stem;
  for (std::size_t p = 0; p < outcome.block.plants.size(); ++p) {
    const Plant& plant = outcome.block.plants[p];
    for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
      given[outcome.block.source_index[i]] = truth_of[p];
      claimed[outcome.block.source_index[i]] = i < plant.stem.end;
    }
  }
  outcome.stems = scoreStems(truly, claimed);
  double right = 0.0, all = 0.0;
  for (std::size_t i = 0; i < source.size(); ++i) {
    if (scene.truth[source[i]].plant < 0) continue;
    all += 1.0;
    right += given[i] == scene.truth[source[i]].plant ? 1.0 : 0.0;
  }
  outcome.plant_accuracy = right / std::max(all, 1.0);
  return outcome;
}

void report(const char* name, const Outcome& outcome) {
  std::printf(
      "%-28s missed %zu, false %zu, base within %.4f m, stem F1 %.3f, plant accuracy %.3f\n", name,
      outcome.missed, outcome.false_plants, outcome.matches.worst, outcome.stems.f1,
      outcome.plant_accuracy);
}

/// What must hold of any segmented block.
void expectConsistent(const Block& block, const SegmentedBlock& out) {
  ASSERT_EQ(out.cloud.size(), block.cloud.size());
  ASSERT_EQ(out.source_index.size(), block.cloud.size());
  std::vector<int> seen(block.cloud.size(), 0);
  for (std::size_t i = 0; i < out.cloud.size(); ++i) {
    ++seen[out.source_index[i]];
    ASSERT_EQ(out.cloud.points[i], block.cloud.points[out.source_index[i]]);
  }
  EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), static_cast<std::ptrdiff_t>(seen.size()))
      << "every point once";
  EXPECT_EQ(out.cloud.origin, block.cloud.origin);
  EXPECT_EQ(out.header.index, block.header.index);
  EXPECT_EQ(out.header.revision, block.header.revision);
  std::uint32_t next = 0U;
  for (const Plant& plant : out.plants) {
    EXPECT_EQ(plant.id, -1);
    EXPECT_EQ(plant.points.begin, next) << "plants lie one behind the other";
    EXPECT_EQ(plant.stem.begin, plant.points.begin);
    EXPECT_LE(plant.stem.end, plant.points.end);
    EXPECT_GT(plant.stem.size(), 0U);
    EXPECT_TRUE(plant.base.allFinite());
    EXPECT_NEAR(out.ground.heightAbove(plant.base), 0.0F, 0.02F) << "the base is on the soil";
    EXPECT_GE(plant.growth.quality, 0.0F);
    EXPECT_LE(plant.growth.quality, 1.0F);
    EXPECT_GT(plant.axis.length(), 0.0F);
    next = plant.points.end;
  }
}

void addRow(Scene& scene, double y, double spacing, double from = -0.8, double to = 0.81) {
  for (double x = from; x < to; x += spacing) {
    PlantTruth plant;
    plant.base = {x, y};
    scene.addPlant(plant);
  }
}

TEST(Segmentation, PlantsOnLevelAndSlopingSoil) {
  for (const double degrees : {0.0, 10.0, 20.0}) {
    const Soil soil = testing::slopingSoil(degrees, 60.0);
    Scene scene(soil, 1U);
    addRow(scene, -0.4, 0.4);
    addRow(scene, 0.4, 0.4);
    const Outcome outcome = segment(scene, soil);
    report(("slope " + std::to_string(static_cast<int>(degrees)) + " deg").c_str(), outcome);
    EXPECT_EQ(outcome.missed, 0U);
    EXPECT_EQ(outcome.false_plants, 0U);
    EXPECT_LT(outcome.matches.worst, 0.015);
    EXPECT_GT(outcome.stems.f1, 0.85);
    EXPECT_GT(outcome.plant_accuracy, 0.9);
    expectConsistent(blockOf(scene, soil), outcome.block);
  }
}

TEST(Segmentation, LeaningPlants) {
  Scene scene(testing::levelSoil(), 2U);
  int k = 0;
  for (const double y : {-0.6, 0.0, 0.6}) {
    for (const double x : {-0.6, 0.0, 0.6}) {
      PlantTruth plant;
      plant.base = {x, y};
      plant.lean = 20.0 * kDegree;
      plant.azimuth = 40.0 * kDegree * k++;
      plant.stem_length = 1.2;
      scene.addPlant(plant);
    }
  }
  const Outcome outcome = segment(scene, testing::levelSoil());
  report("leaning 20 deg", outcome);
  EXPECT_EQ(outcome.missed, 0U);
  EXPECT_EQ(outcome.false_plants, 0U);
  EXPECT_LT(outcome.matches.worst, 0.02);
  EXPECT_GT(outcome.stems.f1, 0.8);
  for (const auto& [truth, found] : outcome.matches.pairs) {
    const Plant& plant = outcome.block.plants[found];
    const Eigen::Vector3f along =
        (plant.axis.pointAt(0.8F * plant.axis.length()) - plant.axis.pointAt(0.0F)).normalized();
    const double azimuth = scene.plants[truth].azimuth;
    const Eigen::Vector3d expected(std::sin(20.0 * kDegree) * std::cos(azimuth),
                                   std::sin(20.0 * kDegree) * std::sin(azimuth),
                                   std::cos(20.0 * kDegree));
    EXPECT_GT(along.cast<double>().dot(expected), std::cos(3.0 * kDegree));
  }
}

TEST(Segmentation, StemsWithGaps) {
  Scene scene(testing::levelSoil(), 3U);
  const double gaps[][2] = {{0.0, 0.15}, {0.3, 0.55}, {0.6, 0.9}, {0.2, 0.4}};
  for (int k = 0; k < 4; ++k) {
    PlantTruth plant;
    plant.base = {-0.75 + 0.5 * k, 0.1};
    plant.gap_low = gaps[k][0];
    plant.gap_high = gaps[k][1];
    scene.addPlant(plant);
  }
  const Outcome outcome = segment(scene, testing::levelSoil());
  report("gaps", outcome);
  EXPECT_EQ(outcome.missed, 0U);
  EXPECT_EQ(outcome.false_plants, 0U) << "one stem in two pieces is one plant";
  EXPECT_LT(outcome.matches.worst, 0.03);
  for (const Plant& plant : outcome.block.plants) EXPECT_GT(plant.axis.length(), 1.2F);
}

TEST(Segmentation, TenCentimetreSpacing) {
  Scene scene(testing::levelSoil(), 4U);
  addRow(scene, 0.0, 0.10, -0.5, 0.51);
  const Outcome outcome = segment(scene, testing::levelSoil());
  report("10 cm spacing", outcome);
  EXPECT_LE(outcome.missed, 1U);
  EXPECT_EQ(outcome.false_plants, 0U);
  EXPECT_GT(outcome.stems.f1, 0.75);
}

TEST(Segmentation, SparseNoisyAndThin) {
  // A seedling's stem of 8 mm; few points; noise as large as half its radius.
  Scene scene(testing::levelSoil(), 5U, 0.002);
  for (const double x : {-0.6, -0.2, 0.2, 0.6}) {
    PlantTruth plant;
    plant.base = {x, 0.0};
    plant.radius = 0.004;
    plant.stem_length = 0.45;
    plant.stem_points_per_metre = 600;
    plant.leaves = 2;
    scene.addPlant(plant);
  }
  const Outcome outcome = segment(scene, testing::levelSoil());
  report("seedlings", outcome);
  EXPECT_EQ(outcome.missed, 0U);
  EXPECT_LE(outcome.false_plants, 1U);
}

/// Every n-th point of a scene, at random.
void thin(Scene& scene, double one_in, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::bernoulli_distribution keeps(1.0 / one_in);
  std::size_t kept = 0U;
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    if (!keeps(random)) continue;
    scene.cloud.points[kept] = scene.cloud.points[i];
    scene.truth[kept++] = scene.truth[i];
  }
  scene.cloud.points.resize(kept);
  scene.truth.resize(kept);
}

// A point every 5 cm of stem: no neighbourhood shows which way it runs.
TEST(Segmentation, VerySparseStands) {
  std::size_t plants = 0U;
  std::size_t missed = 0U;
  std::size_t false_plants = 0U;
  for (std::uint32_t seed = 1U; seed <= 3U; ++seed) {
    Scene scene(testing::levelSoil(), seed, 0.003);
    for (const double y : {-0.7, 0.0, 0.7}) addRow(scene, y, 0.2);
    thin(scene, 80.0, seed);
    const Outcome outcome = segment(scene, testing::levelSoil());
    report("very sparse", outcome);
    plants += scene.plants.size();
    missed += outcome.missed;
    false_plants += outcome.false_plants;
  }
  EXPECT_LE(20U * missed, plants);
  EXPECT_LE(50U * false_plants, plants);
}

TEST(Segmentation, WeedsAreNoPlants) {
  std::size_t false_plants = 0U;
  for (const unsigned seed : {6U, 60U, 600U, 6000U}) {
    Scene scene(testing::levelSoil(), seed);
    for (int k = 0; k < 25; ++k) {
      scene.addWeed({-0.9 + 0.45 * (k % 5), -0.9 + 0.45 * (k / 5)}, 0.06 + 0.005 * k);
    }
    const Outcome outcome = segment(scene, testing::levelSoil());
    report("weeds only", outcome);
    false_plants += outcome.false_plants;
  }
  EXPECT_LE(false_plants, 2U) << "of 100 weeds";
}

TEST(Segmentation, WeedsBelongToNoPlant) {
  Scene scene(testing::levelSoil(), 7U);
  addRow(scene, 0.0, 0.5);
  std::vector<Eigen::Vector2d> weeds;
  for (int k = 0; k < 8; ++k) weeds.emplace_back(-0.8 + 0.22 * k, k % 2 == 0 ? 0.5 : -0.5);
  for (const Eigen::Vector2d& weed : weeds) scene.addWeed(weed, 0.12);
  std::vector<std::size_t> source;
  const Block block = blockOf(scene, testing::levelSoil(), &source);
  const SegmentedBlock out = segmentBlock(block, {});
  double weed_points = 0.0, taken = 0.0;
  for (const Plant& plant : out.plants) {
    for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
      taken += scene.truth[source[out.source_index[i]]].plant < 0 ? 1.0 : 0.0;
    }
  }
  for (const std::size_t i : source) weed_points += scene.truth[i].plant < 0 ? 1.0 : 0.0;
  std::printf("weed points given to plants: %.3f\n", taken / weed_points);
  EXPECT_LT(taken, 0.1 * weed_points);
}

TEST(Segmentation, NoMoreStemPointsTheStricterMIs) {
  Scene scene(testing::levelSoil(), 8U, 0.002);
  addRow(scene, 0.0, 0.4);
  const Block block = blockOf(scene, testing::levelSoil());
  const auto stemPoints = [&](double M) {
    SegmentationParameters parameters;
    parameters.M = M;
    std::size_t count = 0U;
    for (const Plant& plant : segmentBlock(block, parameters).plants) count += plant.stem.size();
    return count;
  };
  std::size_t most = std::numeric_limits<std::size_t>::max();
  for (const double M : {0.2, 0.35, 0.5, 0.65, 0.8}) {
    const std::size_t count = stemPoints(M);
    std::printf("M %.2f: %zu stem points\n", M, count);
    EXPECT_LE(count, most) << "M " << M;
    most = count;
  }
  EXPECT_LT(most, stemPoints(0.2)) << "M matters";
}

TEST(Segmentation, EmptyBlock) {
  Block block;
  block.header.index = {3, -2};
  block.header.revision = 5U;
  const SegmentedBlock out = segmentBlock(block, {});
  EXPECT_TRUE(out.plants.empty());
  EXPECT_TRUE(out.cloud.empty());
  EXPECT_EQ(out.header.index, block.header.index);
  EXPECT_EQ(out.header.revision, 5U);
}

Block blockOfPoints(std::vector<Eigen::Vector3f> points) {
  Block block;
  block.cloud.points = std::move(points);
  block.ground = testing::exactGround(testing::levelSoil());
  return block;
}

TEST(Segmentation, SurvivesOddClouds) {
  std::mt19937 random(9U);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  std::vector<Eigen::Vector3f> upright;
  std::vector<Eigen::Vector3f> lying;
  std::vector<Eigen::Vector3f> wall;
  std::vector<Eigen::Vector3f> table;
  std::vector<Eigen::Vector3f> cloud;
  std::vector<Eigen::Vector3f> buried;
  for (int k = 0; k < 2000; ++k) {
    upright.emplace_back(0.0F, 0.0F, 1.5F * unit(random));
    lying.emplace_back(2.0F * unit(random) - 1.0F, 0.0F, 0.3F);
    wall.emplace_back(unit(random) - 0.5F, 0.0F, 1.5F * unit(random));
    table.emplace_back(unit(random) - 0.5F, unit(random) - 0.5F, 0.7F);
    cloud.emplace_back(unit(random) - 0.5F, unit(random) - 0.5F, 1.5F * unit(random));
    buried.emplace_back(unit(random) - 0.5F, unit(random) - 0.5F, -unit(random));
  }
  const std::vector<Eigen::Vector3f> place(2000U, {0.1F, 0.2F, 0.6F});
  const std::vector<Eigen::Vector3f> one(1U, {0.1F, 0.2F, 0.6F});
  const std::vector<Eigen::Vector3f> two = {{0.1F, 0.2F, 0.6F}, {0.1F, 0.2F, 0.9F}};
  for (const auto& points : {upright, lying, wall, table, cloud, buried, place, one, two}) {
    const Block block = blockOfPoints(points);
    const SegmentedBlock out = segmentBlock(block, {});
    expectConsistent(block, out);
  }
  EXPECT_LE(segmentBlock(blockOfPoints(upright), {}).plants.size(), 1U);
  for (const auto& points : {lying, table, buried, place, one, two}) {
    EXPECT_TRUE(segmentBlock(blockOfPoints(points), {}).plants.empty());
  }
}

TEST(Segmentation, WithoutAnyGroundModel) {
  Scene scene(testing::levelSoil(), 10U);
  addRow(scene, 0.0, 0.5);
  Block block = blockOf(scene, testing::levelSoil());
  block.ground = GroundModel();
  const SegmentedBlock out = segmentBlock(block, {});
  EXPECT_EQ(matchBases(basesOf(scene), basesOf(out)).pairs.size(), scene.plants.size());
}

TEST(Segmentation, OwnsThePlantsOfItsTile) {
  // The tile reaches to 1 m from the middle, the block to 2 m.
  Scene scene(testing::levelSoil(), 11U);
  addRow(scene, 0.0, 0.35, -1.6, 1.61);
  const Outcome outcome = segment(scene, testing::levelSoil());
  EXPECT_EQ(outcome.missed, 0U);
  for (const auto& [truth, found] : outcome.matches.pairs) {
    const double x = std::abs(scene.plants[truth].base.x());
    const Plant& plant = outcome.block.plants[found];
    if (x > 0.98 && x < 1.02 + PlantRegistry::kBorderTolerance) continue;
    EXPECT_EQ(plant.owned, x < 1.0) << "plant at " << x;
  }
}

TEST(Segmentation, OrderedAndDeterministic) {
  Scene scene(testing::levelSoil(), 12U);
  addRow(scene, -0.5, 0.4);
  addRow(scene, 0.5, 0.4);
  const Block block = blockOf(scene, testing::levelSoil());
  const SegmentedBlock first = segmentBlock(block, {});
  const SegmentedBlock second = segmentBlock(block, {});
  EXPECT_EQ(first.source_index, second.source_index);
  ASSERT_EQ(first.plants.size(), second.plants.size());
  for (std::size_t p = 0; p < first.plants.size(); ++p) {
    EXPECT_EQ(first.plants[p].base, second.plants[p].base);
  }
}

TEST(Segmentation, ColoursStayWithTheirPoints) {
  Scene scene(testing::levelSoil(), 13U);
  addRow(scene, 0.0, 0.5);
  Block block = blockOf(scene, testing::levelSoil());
  for (std::uint32_t i = 0; i < block.cloud.size(); ++i) block.cloud.colors.push_back(i);
  const SegmentedBlock out = segmentBlock(block, {});
  ASSERT_EQ(out.cloud.colors.size(), out.cloud.size());
  EXPECT_EQ(out.cloud.colors, out.source_index);
}

// ---------------------------------------------------------------------------- seeds

TEST(StemSeeds, RiseAlongTheStem) {
  const Soil soil = testing::slopingSoil(12.0);
  Scene scene(soil, 14U);
  addRow(scene, 0.0, 0.5);
  const Block block = blockOf(scene, soil);
  const SegmentationParameters parameters;
  const auto radius = static_cast<float>(parameters.seed_radius);
  const NeighborGrid grid(block.cloud.points, radius);
  const auto shapes = computeLocalShapes(block.cloud.points, grid, radius);
  const auto seeds = findStemSeeds(block, shapes, uprightWeights(block, grid, shapes, parameters),
                                   parameters, SeedEvidence::kUpright);
  ASSERT_EQ(seeds.size(), scene.plants.size());
  float score = std::numeric_limits<float>::max();
  std::set<double> seeded;
  for (const StemSeeds& stem : seeds) {
    ASSERT_GE(stem.points.size(), 2U);
    EXPECT_GT(stem.score, 0.0F);
    EXPECT_LE(stem.score, score) << "best-supported first";
    score = stem.score;
    const PlantTruth& nearest_plant = *std::min_element(
        scene.plants.begin(), scene.plants.end(), [&](const PlantTruth& a, const PlantTruth& b) {
          const Eigen::Vector2d at = stem.points.front().head<2>().cast<double>();
          return (at - a.base).norm() < (at - b.base).norm();
        });
    EXPECT_TRUE(seeded.insert(nearest_plant.base.x()).second) << "one per stem";
    for (std::size_t k = 0; k < stem.points.size(); ++k) {
      double nearest = 1.0;
      for (const PlantTruth& plant : scene.plants) {
        nearest = std::min(nearest, (stem.points[k].head<2>().cast<double>() - plant.base).norm());
      }
      EXPECT_LT(nearest, 0.03) << "seeds lie on stems";
      if (k > 0) {
        EXPECT_GT(stem.points[k].z(), stem.points[k - 1].z());
      }
    }
  }
}

TEST(StemSeeds, PersistenceNotDensityMakesAStem) {
  // A ball of leaves at breast height has far more points than the stem beside it.
  Scene scene(testing::levelSoil(), 15U);
  PlantTruth plant;
  plant.base = {-0.5, 0.0};
  plant.leaves = 0;
  plant.stem_points_per_metre = 500;
  scene.addPlant(plant);
  Block block = blockOf(scene, testing::levelSoil());
  std::mt19937 random(16U);
  std::normal_distribution<float> normal(0.0F, 0.05F);
  for (int k = 0; k < 20000; ++k) {
    block.cloud.points.emplace_back(0.5F + normal(random), normal(random), 0.8F + normal(random));
  }
  const SegmentedBlock out = segmentBlock(block, {});
  ASSERT_EQ(out.plants.size(), 1U);
  EXPECT_LT((out.plants[0].base.head<2>().cast<double>() - plant.base).norm(), 0.02);
}

TEST(StemSeeds, DensityFindsWhatShowsNoShape) {
  // Twelve points a metre, scattered by 6 mm: nowhere a line that stands up.
  Block block;
  block.ground = GroundModel({-2.0F, -2.0F}, 4.0F, 2, 2, std::vector<GroundModel::Node>(4U), true);
  std::mt19937 random(17U);
  std::normal_distribution<float> off(0.0F, 0.006F);
  std::uniform_real_distribution<float> height(0.05F, 1.4F);
  for (const float x : {-0.5F, 0.5F}) {
    for (int k = 0; k < 16; ++k) {
      block.cloud.points.emplace_back(x + off(random), off(random), height(random));
    }
  }
  const SegmentationParameters parameters;
  const auto radius = static_cast<float>(parameters.seed_radius);
  const NeighborGrid grid(block.cloud.points, radius);
  const auto shapes = computeLocalShapes(block.cloud.points, grid, radius);
  const auto seedsBy = [&](SeedEvidence evidence, const std::vector<std::uint8_t>& explained,
                           std::size_t most) {
    return findStemSeeds(block, shapes, uprightWeights(block, grid, shapes, parameters), parameters,
                         evidence, {}, explained, most);
  };
  EXPECT_TRUE(seedsBy(SeedEvidence::kUpright, {}, 1000U).empty());
  EXPECT_EQ(seedsBy(SeedEvidence::kDensity, {}, 1000U).size(), 2U);
  EXPECT_EQ(seedsBy(SeedEvidence::kDensity, {}, 1U).size(), 1U);
  std::vector<std::uint8_t> explained(block.cloud.size(), 0U);
  std::fill_n(explained.begin(), 16, std::uint8_t{1});
  const auto others = seedsBy(SeedEvidence::kDensity, explained, 1000U);
  ASSERT_EQ(others.size(), 1U);
  EXPECT_NEAR(others[0].points.front().x(), 0.5F, 0.03F);
}

// ---------------------------------------------------------------------------- organs

/// Upright stems in a row along x, and what lies between them.
class OrgansOfARow : public ::testing::Test {
 protected:
  struct Stem {
    float x;
    float height;
  };

  explicit OrgansOfARow(const std::vector<Stem>& stems) {
    for (const Stem& stem : stems) {
      const auto plant = static_cast<std::int32_t>(axes_.size());
      axes_.emplace_back(
          StemAxis({{{stem.x, 0.0F, 0.0F}, 0.01F}, {{stem.x, 0.0F, stem.height}, 0.01F}}));
      for (int k = 0; 0.003F * static_cast<float>(k) < stem.height; ++k) {
        const float angle = 2.4F * static_cast<float>(k);
        const Eigen::Vector3f around(0.01F * std::cos(angle), 0.01F * std::sin(angle), 0.0F);
        points_.emplace_back(Eigen::Vector3f(stem.x, 0.0F, 0.003F * static_cast<float>(k)) +
                             around);
        owner_.push_back(plant);
      }
    }
  }

  /// A ribbon 4 cm wide from `from` to `to`; returns the span of its points.
  IndexSpan addRibbon(const Eigen::Vector3f& from, const Eigen::Vector3f& to) {
    IndexSpan span;
    span.begin = static_cast<std::uint32_t>(points_.size());
    const Eigen::Vector3f along = to - from;
    const Eigen::Vector3f across = 0.02F * along.cross(Eigen::Vector3f::UnitZ()).normalized();
    const int steps = static_cast<int>(along.norm() / 0.005F);
    for (int k = 0; k <= steps; ++k) {
      for (int side = -2; side <= 2; ++side) {
        points_.emplace_back(from + static_cast<float>(k) / static_cast<float>(steps) * along +
                             0.5F * static_cast<float>(side) * across);
        owner_.push_back(-1);
      }
    }
    span.end = static_cast<std::uint32_t>(points_.size());
    return span;
  }

  void assign(double reach = 0.10) {
    SegmentationParameters parameters;
    parameters.organ_reach = reach;
    assigned_ = assignOrgans(blockOfPoints(points_), axes_, owner_, parameters).plant;
    ASSERT_EQ(assigned_.size(), owner_.size());
    for (std::size_t i = 0; i < owner_.size(); ++i) {
      if (owner_[i] >= 0) {
        ASSERT_EQ(assigned_[i], owner_[i]) << "stems stay";
      }
    }
  }

  double shareOf(const IndexSpan& span, std::int32_t plant) const {
    const auto begin = assigned_.begin();
    return static_cast<double>(std::count(begin + span.begin, begin + span.end, plant)) /
           span.size();
  }

  std::vector<StemAxis> axes_;
  std::vector<Eigen::Vector3f> points_;
  std::vector<std::int32_t> owner_;
  std::vector<std::int32_t> assigned_;
};

/// Two of them, 0.6 m apart.
class Organs : public OrgansOfARow {
 protected:
  Organs() : OrgansOfARow({{-0.3F, 1.2F}, {0.3F, 1.2F}}) {}
};

TEST_F(Organs, LeavesGoToTheStemTheyRiseFrom) {
  const IndexSpan left = addRibbon({-0.29F, 0.0F, 0.5F}, {-0.05F, 0.2F, 0.8F});
  const IndexSpan right = addRibbon({0.29F, 0.0F, 0.6F}, {0.05F, -0.2F, 0.9F});
  assign();
  EXPECT_EQ(shareOf(left, 0), 1.0);
  EXPECT_EQ(shareOf(right, 1), 1.0);
}

TEST_F(Organs, ALeafThatReachesTheOtherStemStaysWithItsOwn) {
  // Its tip passes the other stem at 4 cm.
  const IndexSpan leaf = addRibbon({-0.29F, 0.0F, 0.5F}, {0.4F, 0.06F, 0.9F});
  assign();
  EXPECT_GT(shareOf(leaf, 0), 0.85);
}

TEST_F(Organs, CrossingLeavesStayWhole) {
  // Both end past the other stem and pass it, and each other, at less than a leaf's width.
  const IndexSpan left = addRibbon({-0.29F, 0.02F, 0.50F}, {0.40F, 0.02F, 0.85F});
  const IndexSpan right = addRibbon({0.29F, -0.02F, 0.50F}, {-0.40F, -0.02F, 0.85F});
  assign();
  EXPECT_GT(shareOf(left, 0), 0.9);
  EXPECT_GT(shareOf(right, 1), 0.9);
}

TEST_F(Organs, GapsAreBridgedUpToTheReach) {
  addRibbon({-0.29F, 0.0F, 0.6F}, {-0.20F, 0.0F, 0.7F});
  const IndexSpan torn = addRibbon({-0.15F, 0.0F, 0.755F}, {-0.10F, 0.0F, 0.81F});
  assign(0.10);
  EXPECT_EQ(shareOf(torn, 0), 1.0) << "7 cm are bridged with a reach of 10 cm";
  assign(0.04);
  EXPECT_EQ(shareOf(torn, -1), 1.0) << "but not with 4 cm, which is 6.4 cm straight on";
}

TEST_F(Organs, WhatNoStemReachesIsNobodys) {
  const IndexSpan bird = addRibbon({-0.1F, 0.8F, 1.5F}, {0.1F, 0.8F, 1.5F});
  const IndexSpan weed = addRibbon({0.0F, 0.0F, 0.02F}, {0.06F, 0.05F, 0.12F});
  assign();
  EXPECT_EQ(shareOf(bird, -1), 1.0);
  EXPECT_EQ(shareOf(weed, -1), 1.0);
}

/// A stand whose leaves stay 15 cm below the tops of their stems; the plant in the middle is short.
class OrgansOfAStand : public OrgansOfARow {
 protected:
  static constexpr int kShort = 3;

  OrgansOfAStand() : OrgansOfARow(stems()) {
    for (const Stem& stem : stems()) {
      for (const float side : {-1.0F, 1.0F}) {
        addRibbon({stem.x, side * 0.01F, stem.height - 0.45F},
                  {stem.x, side * 0.20F, stem.height - 0.15F});
      }
    }
  }

  static std::vector<Stem> stems() {
    std::vector<Stem> stems;
    for (int k = 0; k < 7; ++k) {
      stems.push_back({0.25F * static_cast<float>(k), k == kShort ? 1.2F : 1.6F});
    }
    return stems;
  }
};

TEST_F(OrgansOfAStand, WhatHangsAboveAShortPlantIsATallNeighbours) {
  // By its slope and its distance it would be the short plant's.
  const float x = stems()[kShort].x;
  const IndexSpan torn = addRibbon({x + 0.09F, 0.0F, 1.28F}, {x + 0.15F, 0.0F, 1.37F});
  assign(0.20);
  EXPECT_EQ(shareOf(torn, kShort), 0.0);
}

/// A stand whose leaves lie across the row, but for the plant in the middle.
class OrgansInPlanes : public OrgansOfARow {
 protected:
  static constexpr int kAlong = 3;
  static constexpr int kPlants = 7;
  static constexpr float kSpacing = 0.4F;

  OrgansInPlanes() : OrgansOfARow(stems()) {
    for (int plant = 0; plant < kPlants; ++plant) {
      const Eigen::Vector3f foot(kSpacing * static_cast<float>(plant), 0.0F, 0.0F);
      const Eigen::Vector3f plane =
          plant == kAlong ? Eigen::Vector3f::UnitX() : Eigen::Vector3f::UnitY();
      for (int leaf = 0; leaf < 6; ++leaf) {
        const float side = leaf % 2 == 0 ? 1.0F : -1.0F;
        const float height = 0.3F + 0.12F * static_cast<float>(leaf);
        addRibbon(foot + side * 0.01F * plane + height * Eigen::Vector3f::UnitZ(),
                  foot + side * 0.18F * plane + (height + 0.1F) * Eigen::Vector3f::UnitZ());
      }
    }
  }

  static std::vector<Stem> stems() {
    std::vector<Stem> stems;
    for (int k = 0; k < kPlants; ++k) stems.push_back({kSpacing * static_cast<float>(k), 1.6F});
    return stems;
  }
};

TEST_F(OrgansInPlanes, ATornLeafGoesToThePlantInWhosePlaneItLies) {
  // Level, along the row: by its slope it is the neighbour's, from which it is farther.
  const float middle = kSpacing * (static_cast<float>(kAlong) - 0.5F) + 0.02F;
  const IndexSpan torn = addRibbon({middle - 0.06F, 0.0F, 1.3F}, {middle + 0.06F, 0.0F, 1.3F});
  assign(0.10);
  EXPECT_EQ(shareOf(torn, kAlong), 1.0);
}

TEST_F(Organs, NoStemsAndNoPoints) {
  EXPECT_TRUE(assignOrgans(Block(), {}, {}, {}).plant.empty());
  std::fill(owner_.begin(), owner_.end(), -1);
  assign();
  EXPECT_EQ(std::count(assigned_.begin(), assigned_.end(), -1),
            static_cast<std::ptrdiff_t>(assigned_.size()));
}

}  // namespace
}  // namespace field_phenotyping
