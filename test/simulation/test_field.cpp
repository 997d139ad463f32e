#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "simulation/field.hpp"
#include "simulation/random.hpp"

namespace field_phenotyping::simulation {
namespace {

FieldSettings smallField() {
  FieldSettings settings;
  settings.rows = 2;
  settings.plants_per_row = 6;
  return settings;
}

bool samePlants(const Field& a, const Field& b) {
  return a.plants.size() == b.plants.size() &&
         std::equal(a.plants.begin(), a.plants.end(), b.plants.begin(),
                    [](const MaizePlant& p, const MaizePlant& q) {
                      return p.stem.base.head<2>() == q.stem.base.head<2>() &&
                             p.stem.reference_semi_major == q.stem.reference_semi_major &&
                             p.stem.height == q.stem.height;
                    });
}

TEST(RandomStream, HasTheMomentsOfItsDistributions) {
  RandomStream random(3, Stream::kLayout, 9);
  double sum = 0.0;
  double sum_of_squares = 0.0;
  double uniform = 0.0;
  constexpr int kDraws = 200000;
  for (int i = 0; i < kDraws; ++i) {
    const double draw = random.normal();
    sum += draw;
    sum_of_squares += draw * draw;
    uniform += random.uniform();
  }
  EXPECT_NEAR(sum / kDraws, 0.0, 0.01);
  EXPECT_NEAR(sum_of_squares / kDraws, 1.0, 0.02);
  EXPECT_NEAR(uniform / kDraws, 0.5, 0.005);
}

TEST(RandomStream, StreamsDiffer) {
  std::set<std::uint64_t> first_draws;
  for (std::uint64_t seed = 0; seed < 3; ++seed) {
    for (const Stream stream : {Stream::kLayout, Stream::kPlant, Stream::kWeed}) {
      for (std::uint64_t index = 0; index < 100; ++index) {
        first_draws.insert(RandomStream(seed, stream, index).bits());
      }
    }
  }
  EXPECT_EQ(first_draws.size(), 900U);
}

TEST(Field, IsDeterministic) {
  const Field a = growField(smallField(), 5);
  const Field b = growField(smallField(), 5);
  EXPECT_EQ(a.mesh.vertices, b.mesh.vertices);
  EXPECT_FALSE(samePlants(a, growField(smallField(), 6)));
}

TEST(Field, WeedsAndSoilDoNotChangeThePlants) {
  FieldSettings other = smallField();
  other.weeds = 50;
  other.terrain.slope_deg = 8.0;
  other.terrain.ridge_height = 0.06;
  EXPECT_TRUE(samePlants(growField(smallField(), 5), growField(other, 5)));
}

TEST(Field, BasesStandOnTheSoilNearTheirPlaces) {
  FieldSettings settings = smallField();
  settings.terrain.slope_deg = 5.0;
  settings.terrain.slope_azimuth_deg = 30.0;
  settings.terrain.ridge_height = 0.08;
  settings.row_azimuth_deg = 25.0;
  const Field field = growField(settings, 1);
  for (const MaizePlant& plant : field.plants) {
    const Eigen::Vector2d base = plant.stem.base.head<2>();
    EXPECT_DOUBLE_EQ(plant.stem.base.z(), field.terrain.height(base));
    const Eigen::Vector2d nominal =
        field.position(settings.plant_spacing * (plant.id % 6), settings.row_spacing * plant.row);
    EXPECT_LT((base - nominal).norm(), 4.0 * settings.position_stddev);
  }
}

TEST(Field, SoilMeshFollowsTheTerrainAndEndsAtTheBorder) {
  FieldSettings settings = smallField();
  settings.plants_per_row = 0;
  settings.bare_length = 2.0;
  settings.terrain.ridge_height = 0.06;
  const Field field = growField(settings, 1);
  float left = 0.0F;
  float right = 0.0F;
  for (const auto& triangle : field.mesh.triangles) {
    Eigen::Vector3f centre = Eigen::Vector3f::Zero();
    for (const std::uint32_t corner : triangle) {
      centre += field.mesh.vertices[corner] / 3.0F;
      left = std::min(left, field.mesh.vertices[corner].x());
      right = std::max(right, field.mesh.vertices[corner].x());
    }
    EXPECT_NEAR(static_cast<double>(centre.z()),
                field.terrain.height(centre.head<2>().cast<double>()), 5e-4);
  }
  EXPECT_FLOAT_EQ(left, -1.0F);
  EXPECT_FLOAT_EQ(right, 3.0F);
}

TEST(Terrain, RoughnessHasItsStandardDeviation) {
  TerrainSettings settings;
  settings.roughness = 0.01;
  const Terrain terrain(settings, 0.0, 0.75, 4);
  double sum = 0.0;
  double sum_of_squares = 0.0;
  constexpr int kSide = 200;
  for (int i = 0; i < kSide; ++i) {
    for (int j = 0; j < kSide; ++j) {
      const double z = terrain.height({0.1 * i, 0.1 * j});
      sum += z;
      sum_of_squares += z * z;
    }
  }
  const double mean = sum / (kSide * kSide);
  EXPECT_NEAR(std::sqrt(sum_of_squares / (kSide * kSide) - mean * mean), 0.01, 0.001);
}

TEST(Field, MissingPlantsLeaveGapsButNoIds) {
  FieldSettings settings = smallField();
  settings.plants_per_row = 200;
  settings.missing_share = 0.3;
  settings.plant.stage = GrowthStage::kSeedling;
  const Field field = growField(settings, 2);
  EXPECT_NEAR(static_cast<double>(field.plants.size()), 280.0, 40.0);
  for (std::size_t i = 0; i < field.plants.size(); ++i) {
    EXPECT_EQ(field.plants[i].id, static_cast<std::int32_t>(i));
  }
}

struct StageRange {
  GrowthStage stage;
  double lowest_height, highest_height;        // of the mean [m]
  double smallest_diameter, largest_diameter;  // of the mean [m]
};

class EveryStage : public testing::TestWithParam<StageRange> {};

TEST_P(EveryStage, HasRealisticDimensions) {
  FieldSettings settings;
  settings.plant.stage = GetParam().stage;
  const Field field = growField(settings, 11);
  double height = 0.0;
  double diameter = 0.0;
  for (const MaizePlant& plant : field.plants) {
    height += plant.plant_height / static_cast<double>(field.plants.size());
    diameter += 2.0 * plant.stem.smoothSemiMajor(plant.diameter_height) /
                static_cast<double>(field.plants.size());
    EXPECT_GE(plant.stem.axis_ratio, 0.80);
    EXPECT_LE(plant.stem.axis_ratio, 0.95);
    EXPECT_GE(plant.leaf_count, 4U);
    EXPECT_LE(plant.leaf_count, 12U);
    EXPECT_GE(plant.plant_height, plant.stem.height);
  }
  EXPECT_GT(height, GetParam().lowest_height);
  EXPECT_LT(height, GetParam().highest_height);
  EXPECT_GT(diameter, GetParam().smallest_diameter);
  EXPECT_LT(diameter, GetParam().largest_diameter);
}

INSTANTIATE_TEST_SUITE_P(Stages, EveryStage,
                         testing::Values(StageRange{GrowthStage::kSeedling, 0.3, 0.5, 0.008, 0.012},
                                         StageRange{GrowthStage::kJointing, 1.0, 1.4, 0.016, 0.022},
                                         StageRange{GrowthStage::kTasselling, 1.8, 2.3, 0.018,
                                                    0.026},
                                         StageRange{GrowthStage::kRipe, 1.8, 2.3, 0.018, 0.026}),
                         [](const testing::TestParamInfo<StageRange>& stage_info) {
                           return stageName(stage_info.param.stage);
                         });

TEST(Field, MeanSizesCanBeSet) {
  FieldSettings settings;
  settings.plant.mean_height = 1.8;
  settings.plant.mean_stem_diameter = 0.030;
  const Field field = growField(settings, 3);
  double height = 0.0;
  double diameter = 0.0;
  for (const MaizePlant& plant : field.plants) {
    height += plant.plant_height / static_cast<double>(field.plants.size());
    diameter += 2.0 * plant.stem.reference_semi_major / static_cast<double>(field.plants.size());
  }
  EXPECT_NEAR(height, 1.8, 0.06);
  EXPECT_NEAR(diameter, 0.030, 0.001);
}

TEST(Field, PlantSurfacesCarryTheirPlantAndPart) {
  FieldSettings settings = smallField();
  settings.weeds = 5;
  const Field field = growField(settings, 5);
  std::set<std::int32_t> stems;
  std::set<std::int32_t> organs;
  for (const Surface& surface : field.mesh.surfaces) {
    EXPECT_EQ(surface.part == Part::kGround, surface.plant_id == -1);
    if (surface.part == Part::kStem) {
      stems.insert(surface.plant_id);
    } else if (surface.part == Part::kOrgan) {
      organs.insert(surface.plant_id);
    }
  }
  EXPECT_EQ(stems.size(), 12U);
  EXPECT_EQ(stems, organs);
}

TEST(Field, WeedsAreLow) {
  FieldSettings settings;
  settings.plants_per_row = 0;
  settings.weeds = 200;
  settings.terrain.roughness = 0.0;
  const Field field = growField(settings, 8);
  float highest = 0.0F;
  for (const Eigen::Vector3f& vertex : field.mesh.vertices) {
    highest = std::max(highest, vertex.z());
  }
  EXPECT_GT(highest, 0.15F);
  EXPECT_LT(highest, 0.28F);
}

TEST(Field, RefusesImpossibleSettings) {
  FieldSettings settings = smallField();
  settings.row_spacing = 0.0;
  EXPECT_THROW(growField(settings, 1), std::invalid_argument);
  settings = smallField();
  settings.missing_share = 1.0;
  EXPECT_THROW(growField(settings, 1), std::invalid_argument);
  settings = smallField();
  settings.terrain.slope_deg = 80.0;
  EXPECT_THROW(growField(settings, 1), std::invalid_argument);
}

}  // namespace
}  // namespace field_phenotyping::simulation
