// Soil model against soil of exactly known shape.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>
#include <stdexcept>

#include "field_phenotyping/preprocessing/ground_estimation.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::PlantTruth;
using testing::Scene;
using testing::Soil;

const Eigen::Vector2d kLow(-1.6, -1.6);
const Eigen::Vector2d kHigh(1.6, 1.6);
constexpr double kDensity = 4000.0;  // [1/m^2]

/// Error of the model over the middle of the field [m].
struct HeightError {
  double rms = 0.0;
  double worst = 0.0;
};

HeightError errorOf(const GroundModel& ground, const Soil& soil, double half_width = 1.4) {
  HeightError error;
  double squares = 0.0;
  int count = 0;
  for (double x = -half_width; x <= half_width; x += 0.05) {
    for (double y = -half_width; y <= half_width; y += 0.05) {
      const double difference =
          ground.heightAt(static_cast<float>(x), static_cast<float>(y)) - soil(x, y);
      squares += difference * difference;
      error.worst = std::max(error.worst, std::abs(difference));
      ++count;
    }
  }
  error.rms = std::sqrt(squares / count);
  return error;
}

/// How well classifyGround() told soil from what stands on it.
struct GroundScore {
  double soil_found = 0.0;  // share of the soil points
  double high_lost = 0.0;   // share of the plant points over 6 cm that were taken for soil
};

GroundScore scoreGround(const Scene& scene, const GroundModel& ground,
                        const PreprocessingParameters& parameters) {
  const auto is_ground = classifyGround(scene.cloud, ground, parameters);
  double soil = 0.0, found = 0.0, high = 0.0, lost = 0.0;
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    const Eigen::Vector3d p = scene.cloud.points[i].cast<double>();
    if (scene.truth[i].soil) {
      soil += 1.0;
      found += is_ground[i];
    } else if (p.z() - scene.soilAt(p.x(), p.y()) > 0.06) {
      high += 1.0;
      lost += is_ground[i];
    }
  }
  return {found / std::max(soil, 1.0), lost / std::max(high, 1.0)};
}

void addPlants(Scene& scene) {
  for (const double y : {-1.1, -0.35, 0.4, 1.15}) {
    for (double x = -1.3; x < 1.4; x += 0.2) {
      PlantTruth plant;
      plant.base = {x, y};
      scene.addPlant(plant);
    }
  }
}

TEST(GroundModel, TellsAtOnceOnlyWhatLiesHigher) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> uniform(-2.0F, 2.0F);
  std::vector<GroundModel::Node> nodes(20);
  for (GroundModel::Node& node : nodes) node.height = 90.0F + 0.3F * uniform(random);
  const GroundModel ground({-1.0F, -1.0F}, 0.5F, 5, 4, nodes, true);
  int told = 0;
  for (int k = 0; k < 10000; ++k) {
    const Eigen::Vector3f point(uniform(random), uniform(random), 90.0F + uniform(random));
    if (!ground.clearlyAbove(point, 0.2F)) continue;
    ++told;
    EXPECT_GT(ground.heightAbove(point), 0.2F);
  }
  EXPECT_GT(told, 2000);
}

TEST(GroundModel, InterpolatesBilinearly) {
  // z = 0.1 x + 0.2 y + 0.3 x y is bilinear, so it must be met exactly between the nodes.
  const auto height = [](float x, float y) { return 0.1F * x + 0.2F * y + 0.3F * x * y; };
  std::vector<GroundModel::Node> nodes;
  for (int j = 0; j < 3; ++j) {
    for (int i = 0; i < 4; ++i) {
      const float x = -1.0F + 0.5F * static_cast<float>(i);
      const float y = 2.0F + 0.5F * static_cast<float>(j);
      nodes.push_back({height(x, y), 0.01F * x + 0.05F, static_cast<std::uint8_t>(i < 2 ? 1 : 0)});
    }
  }
  const GroundModel ground({-1.0F, 2.0F}, 0.5F, 4, 3, nodes, true);
  for (const Eigen::Vector2f& p : {Eigen::Vector2f(-1.0F, 2.0F), Eigen::Vector2f(-0.7F, 2.2F),
                                   Eigen::Vector2f(0.49F, 2.99F), Eigen::Vector2f(0.5F, 3.0F)}) {
    EXPECT_NEAR(ground.heightAt(p.x(), p.y()), height(p.x(), p.y()), 0.08F) << p.transpose();
    EXPECT_NEAR(ground.stddevAt(p.x(), p.y()), 0.01F * p.x() + 0.05F, 1e-6F);
    EXPECT_NEAR(ground.heightAbove({p.x(), p.y(), 1.0F}), 1.0F - ground.heightAt(p.x(), p.y()),
                1e-6F);
  }
  // Halfway in a cell: the mean of its corners.
  EXPECT_NEAR(ground.heightAt(-0.75F, 2.25F),
              0.25F * (height(-1.0F, 2.0F) + height(-0.5F, 2.0F) + height(-1.0F, 2.5F) +
                       height(-0.5F, 2.5F)),
              1e-6F);
  // Outside, the border's value.
  EXPECT_FLOAT_EQ(ground.heightAt(-9.0F, 2.0F), height(-1.0F, 2.0F));
  EXPECT_FLOAT_EQ(ground.heightAt(9.0F, 9.0F), height(0.5F, 3.0F));
  EXPECT_TRUE(ground.seenAt(-1.0F, 2.5F));
  EXPECT_FALSE(ground.seenAt(0.5F, 2.5F));
}

TEST(GroundModel, EmptyAndMalformed) {
  const GroundModel empty;
  EXPECT_TRUE(empty.empty());
  EXPECT_FALSE(empty.observed());
  EXPECT_EQ(empty.heightAt(3.0F, 4.0F), 0.0F);
  EXPECT_FALSE(empty.seenAt(3.0F, 4.0F));
  EXPECT_THROW(GroundModel({0.0F, 0.0F}, 0.5F, 2, 2, std::vector<GroundModel::Node>(3U), true),
               std::invalid_argument);
  EXPECT_THROW(GroundModel({0.0F, 0.0F}, 0.0F, 2, 2, std::vector<GroundModel::Node>(4U), true),
               std::invalid_argument);
  const GroundModel one({0.0F, 0.0F}, 0.5F, 1, 1, {{0.7F, 0.01F, 1U}}, true);
  EXPECT_FLOAT_EQ(one.heightAt(-3.0F, 5.0F), 0.7F);
}

TEST(Ground, Planes) {
  for (const double degrees : {0.0, 5.0, 10.0, 17.0, 24.0}) {
    for (const double azimuth : {0.0, 75.0, 200.0}) {
      const Soil soil = testing::slopingSoil(degrees, azimuth);
      Scene scene(soil, 1U);
      scene.addSoil(kLow, kHigh, kDensity);
      const PreprocessingParameters parameters;
      const GroundModel ground = estimateGround(scene.cloud, parameters);
      const HeightError error = errorOf(ground, soil);
      EXPECT_TRUE(ground.observed());
      EXPECT_LT(error.rms, 0.002) << degrees << " deg towards " << azimuth;
      EXPECT_LT(error.worst, 0.006) << degrees << " deg towards " << azimuth;
      EXPECT_GT(scoreGround(scene, ground, parameters).soil_found, 0.98);
    }
  }
}

TEST(Ground, SlopesUnderPlants) {
  for (const double degrees : {0.0, 10.0, 20.0}) {
    const Soil soil = testing::slopingSoil(degrees, 30.0);
    Scene scene(soil, 2U);
    scene.addSoil(kLow, kHigh, kDensity);
    addPlants(scene);
    const PreprocessingParameters parameters;
    const GroundModel ground = estimateGround(scene.cloud, parameters);
    const HeightError error = errorOf(ground, soil);
    const GroundScore score = scoreGround(scene, ground, parameters);
    std::printf("slope %2.0f deg under plants: rms %.4f m, worst %.4f m, soil %.3f, lost %.4f\n",
                degrees, error.rms, error.worst, score.soil_found, score.high_lost);
    EXPECT_TRUE(ground.observed());
    EXPECT_LT(error.rms, 0.005);
    EXPECT_LT(error.worst, 0.02);
    EXPECT_GT(score.soil_found, 0.97);
    EXPECT_LT(score.high_lost, 0.005);
  }
}

TEST(Ground, RidgesAreFollowed) {
  for (const double phase : {0.0, 0.2, 0.4}) {
    const auto ridges = testing::ridgedSoil(0.06, 0.75);
    const Soil soil = [=](double x, double y) { return ridges(x, y + phase) + 0.08 * x; };
    Scene scene(soil, 3U);
    scene.addSoil(kLow, kHigh, kDensity);
    const PreprocessingParameters parameters;
    const GroundModel ground = estimateGround(scene.cloud, parameters);
    const HeightError error = errorOf(ground, soil);
    const GroundScore score = scoreGround(scene, ground, parameters);
    std::printf("ridges: rms %.4f m, worst %.4f m, soil %.3f\n", error.rms, error.worst,
                score.soil_found);
    // A plane would be off by 0.06 / sqrt(8) = 0.021 m, and by 0.030 m on the crests.
    EXPECT_LT(error.rms, 0.003);
    EXPECT_LT(error.worst, 0.012);
    EXPECT_GT(score.soil_found, 0.95);
  }
}

TEST(Ground, RoughSoil) {
  Scene scene(testing::levelSoil(), 4U);
  scene.addSoil(kLow, kHigh, kDensity, 0.010);
  const PreprocessingParameters parameters;
  const GroundModel ground = estimateGround(scene.cloud, parameters);
  EXPECT_LT(errorOf(ground, testing::levelSoil()).rms, 0.003);
  EXPECT_GT(scoreGround(scene, ground, parameters).soil_found, 0.97);
  EXPECT_NEAR(ground.stddevAt(0.0F, 0.0F), 0.010F, 0.004F) << "the roughness is reported";
}

TEST(Ground, AFootBelongsToWhatStandsOnIt) {
  Scene scene(testing::levelSoil(), 11U);
  scene.addSoil(kLow, kHigh, kDensity);
  PlantTruth seedling;
  seedling.stem_length = 0.16;
  seedling.radius = 0.004;
  seedling.leaves = 0;
  seedling.stem_points_per_metre = 300;
  for (const double x : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
    seedling.base = {x, 0.1};
    scene.addPlant(seedling);
  }
  const PreprocessingParameters parameters;
  const GroundModel ground = estimateGround(scene.cloud, parameters);
  const auto is_ground = classifyGround(scene.cloud, ground, parameters);
  double foot = 0.0, foot_kept = 0.0, soil = 0.0, soil_found = 0.0;
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    if (scene.truth[i].soil) {
      soil += 1.0;
      soil_found += is_ground[i];
    } else if (scene.cloud.points[i].z() > 0.012F && scene.cloud.points[i].z() < 0.022F) {
      foot += 1.0;
      foot_kept += 1 - is_ground[i];
    }
  }
  ASSERT_GT(foot, 10.0);
  EXPECT_GT(foot_kept / foot, 0.9);
  EXPECT_GT(soil_found / soil, 0.998) << "stones and clods alone are soil";
}

TEST(Ground, UnderWeeds) {
  const Soil soil = testing::slopingSoil(8.0, -40.0);
  Scene scene(soil, 5U);
  scene.addSoil(kLow, kHigh, kDensity);
  for (int i = 0; i < 10; ++i) {
    for (int j = 0; j < 10; ++j) {
      scene.addWeed({-1.5 + 0.33 * i, -1.5 + 0.33 * j + 0.1 * (i % 2)}, 0.05 + 0.02 * (i % 5));
    }
  }
  const PreprocessingParameters parameters;
  const GroundModel ground = estimateGround(scene.cloud, parameters);
  const HeightError error = errorOf(ground, soil);
  std::printf("under weeds: rms %.4f m, worst %.4f m\n", error.rms, error.worst);
  EXPECT_LT(error.rms, 0.006);
  EXPECT_LT(error.worst, 0.025);
}

TEST(Ground, SparseSoilUnderADenseCanopy) {
  // Few beams get through: a hundredth of the points is soil.
  Scene scene(testing::levelSoil(), 6U);
  scene.addSoil(kLow, kHigh, 150.0);
  addPlants(scene);
  const PreprocessingParameters parameters;
  const GroundModel ground = estimateGround(scene.cloud, parameters);
  const HeightError error = errorOf(ground, testing::levelSoil());
  std::printf("sparse soil: rms %.4f m, worst %.4f m\n", error.rms, error.worst);
  EXPECT_TRUE(ground.observed());
  EXPECT_LT(error.rms, 0.02);
}

TEST(Ground, ShadowsAreFilledAndSaySo) {
  // No soil seen in the middle, as behind a hedge.
  const Soil soil = testing::slopingSoil(6.0, 90.0);
  Scene scene(soil, 7U);
  scene.addSoil(kLow, {-0.7, 1.6}, kDensity);
  scene.addSoil({0.7, -1.6}, kHigh, kDensity);
  const GroundModel ground = estimateGround(scene.cloud, PreprocessingParameters());
  EXPECT_TRUE(ground.observed());
  EXPECT_TRUE(ground.seenAt(-1.2F, 0.0F));
  EXPECT_FALSE(ground.seenAt(0.0F, 0.0F));
  EXPECT_NEAR(ground.heightAt(0.0F, 0.0F), soil(0.0, 0.0), 0.02);
  EXPECT_NEAR(ground.heightAt(0.0F, 1.2F), soil(0.0, 1.2), 0.04);
  EXPECT_GT(ground.stddevAt(0.0F, 0.0F), 1.5F * ground.stddevAt(-1.2F, 0.0F))
      << "extrapolated heights are less certain";
}

TEST(Ground, SoilCroppedAway) {
  Scene scene(testing::levelSoil(), 8U);
  addPlants(scene);
  const PreprocessingParameters parameters;
  PointCloud above;
  for (const Eigen::Vector3f& point : scene.cloud.points) {
    if (point.z() > 0.02F) above.points.push_back(point);
  }
  const GroundModel ground = estimateGround(above, parameters);
  EXPECT_FALSE(ground.observed());
  EXPECT_FALSE(ground.seenAt(0.0F, 0.0F));
  const auto is_ground = classifyGround(above, ground, parameters);
  EXPECT_EQ(std::count(is_ground.begin(), is_ground.end(), 1U), 0) << "no plant point is soil";
  EXPECT_NEAR(ground.heightAt(0.0F, 0.0F), 0.02, 0.05) << "the lowest plant points stand in for it";
}

TEST(Ground, OnePlantWithoutSoil) {
  Scene scene(testing::levelSoil(), 9U);
  PlantTruth plant;
  plant.base = {0.1, -0.2};
  scene.addPlant(plant);
  const PreprocessingParameters parameters;
  const GroundModel ground = estimateGround(scene.cloud, parameters);
  EXPECT_FALSE(ground.observed());
  EXPECT_NEAR(ground.heightAt(0.1F, -0.2F), 0.0F, 0.05F);
}

TEST(Ground, AStemAndALeafAreNoSoil) {
  // What a neighbouring block sees in its margin: few places, the stem's foot a good share of them.
  Scene scene(testing::levelSoil(), 3U);
  for (const double x : {0.1, 0.7}) {
    PlantTruth plant;
    plant.base = {x, 0.0};
    scene.addPlant(plant);
  }
  PointCloud margin;
  for (const Eigen::Vector3f& point : scene.cloud.points) {
    if (point.x() > 0.4F) margin.points.push_back(point);
  }
  const GroundModel ground = estimateGround(margin, PreprocessingParameters());
  EXPECT_FALSE(ground.observed());
  EXPECT_NEAR(ground.heightAt(0.7F, 0.0F), 0.0F, 0.02F);
}

TEST(Ground, HardlyAnyPoints) {
  const PreprocessingParameters parameters;
  const GroundModel none = estimateGround(PointCloud(), parameters);
  EXPECT_TRUE(none.empty());
  EXPECT_FALSE(none.observed());
  EXPECT_TRUE(classifyGround(PointCloud(), none, parameters).empty());
  PointCloud cloud;
  for (const Eigen::Vector3f& point :
       {Eigen::Vector3f(0.5F, 0.5F, 0.3F), Eigen::Vector3f(0.6F, 0.5F, 0.31F),
        Eigen::Vector3f(0.5F, 0.5F, 0.9F), Eigen::Vector3f(-0.5F, 0.2F, 0.3F)}) {
    cloud.points.push_back(point);
    const GroundModel ground = estimateGround(cloud, parameters);
    EXPECT_TRUE(std::isfinite(ground.heightAt(0.5F, 0.5F)));
    EXPECT_NEAR(ground.heightAt(0.5F, 0.5F), 0.3F, 0.1F) << cloud.size() << " points";
    EXPECT_EQ(classifyGround(cloud, ground, parameters).size(), cloud.size());
  }
}

TEST(Ground, Deterministic) {
  Scene scene(testing::slopingSoil(7.0), 10U);
  scene.addSoil(kLow, kHigh, 500.0);
  addPlants(scene);
  const PreprocessingParameters parameters;
  const GroundModel first = estimateGround(scene.cloud, parameters);
  const GroundModel second = estimateGround(scene.cloud, parameters);
  ASSERT_EQ(first.nodes().size(), second.nodes().size());
  for (std::size_t i = 0; i < first.nodes().size(); ++i) {
    ASSERT_EQ(first.nodes()[i].height, second.nodes()[i].height);
    ASSERT_EQ(first.nodes()[i].stddev, second.nodes()[i].stddev);
  }
}

}  // namespace
}  // namespace field_phenotyping
