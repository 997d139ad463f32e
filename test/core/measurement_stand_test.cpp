// Rows and canopy of a stand whose plan is known.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "field_phenotyping/measurement/stand_summary.hpp"

namespace field_phenotyping {
namespace {

constexpr double kDegree = M_PI / 180.0;

/// Rows 0.75 m apart of 12 plants 0.2 m apart, without those that `missing` says.
template <class Missing>
std::vector<Phenotype> stand(double azimuth, double jitter, const Missing& missing) {
  std::mt19937 engine(4U);
  std::normal_distribution<double> normal;
  const Eigen::Vector2d along(std::cos(azimuth), std::sin(azimuth));
  const Eigen::Vector2d left(-along.y(), along.x());
  std::vector<Phenotype> plants;
  for (int row = 0; row < 4; ++row) {
    for (int i = 0; i < 12; ++i) {
      const Eigen::Vector2d offset(jitter * normal(engine), jitter * normal(engine));
      if (missing(row, i)) continue;
      Phenotype plant;
      plant.base.head<2>() =
          Eigen::Vector2d(448000.0, 5411000.0) + 0.2 * i * along + 0.75 * row * left + offset;
      plants.push_back(plant);
    }
  }
  std::shuffle(plants.begin(), plants.end(), engine);
  return plants;
}

TEST(Rows, CountsGapsAndSpacingsWhateverTheDirection) {
  for (const double azimuth : {0.0, 33.0, 90.0, -47.0}) {
    std::vector<Phenotype> plants = stand(azimuth * kDegree, 0.015, [](int row, int i) {
      return (row == 1 && (i == 4 || i == 5)) || (row == 3 && i == 2);
    });
    const std::vector<RowSummary> rows = summariseRows(plants);
    ASSERT_EQ(rows.size(), 4U) << azimuth;
    EXPECT_EQ(rows[0].plants, 12U);
    EXPECT_EQ(rows[1].plants, 10U);
    EXPECT_EQ(rows[2].plants, 12U);
    EXPECT_EQ(rows[3].plants, 11U);
    EXPECT_EQ(rows[0].gaps + rows[2].gaps, 0U);
    EXPECT_EQ(rows[1].gaps, 1U);
    EXPECT_EQ(rows[1].missing, 2U);
    EXPECT_EQ(rows[3].missing, 1U);
    EXPECT_NEAR(rows[1].longest_gap, 0.6, 0.07);
    for (const RowSummary& row : rows) {
      EXPECT_NEAR(row.length, 2.2, 0.08);
      EXPECT_NEAR((row.end - row.start).norm(), row.length, 1e-9);
      EXPECT_NEAR(row.spacing.value, 0.2, 0.03);
      EXPECT_NEAR(row.spacing.value, 0.2, 3.5 * row.spacing.stddev);
      EXPECT_EQ(row.plants_stddev, 0.0);
    }
    for (std::size_t i = 0; i + 1U < rows.size(); ++i) {
      EXPECT_NEAR(rows[i].row_spacing.value, 0.75, 3.0 * rows[i].row_spacing.stddev);
      EXPECT_GT(rows[i].row_spacing.stddev, 0.002);
      EXPECT_LT(rows[i].row_spacing.stddev, 0.02);
    }
    EXPECT_TRUE(std::isnan(rows.back().row_spacing.value));
  }
}

TEST(Rows, DoubtfulPlantsMakeTheCountUncertain) {
  std::vector<Phenotype> plants = stand(0.0, 0.0, [](int row, int) { return row > 0; });
  for (std::size_t i = 0; i < 4U; ++i) plants[i].flags |= kLowConfidence;
  const std::vector<RowSummary> rows = summariseRows(plants);
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].plants, 12U);
  EXPECT_DOUBLE_EQ(rows[0].plants_stddev, 1.0);
}

TEST(Rows, NoneOfTwoPlants) {
  EXPECT_TRUE(summariseRows({}).empty());
  EXPECT_TRUE(summariseRows(std::vector<Phenotype>(2)).empty());
}

TEST(Canopy, CoverFallsWithHeight) {
  // 40 cells of 20 cm: half of them up to 1 m, half up to 2 m; soil at z = 0.5.
  auto segmented = std::make_shared<SegmentedBlock>();
  segmented->header.tile_size = 2.0;
  segmented->ground = GroundModel({0.0F, 0.0F}, 2.0F, 2, 2,
                                  std::vector<GroundModel::Node>(4, {0.5F, 0.01F, 1U}), true);
  for (int i = 0; i < 10; ++i) {
    for (int j = 0; j < 4; ++j) {
      const float top = j < 2 ? 1.0F : 2.0F;
      for (float z = 0.05F; z <= top + 0.001F; z += 0.05F) {
        segmented->cloud.points.push_back(
            {0.2F * static_cast<float>(i) + 0.1F, 0.2F * static_cast<float>(j) + 0.1F, 0.5F + z});
      }
    }
  }
  segmented->cloud.points.push_back({-0.3F, 0.1F, 9.0F});  // of a neighbour's tile
  Plant plant;
  plant.points.end = static_cast<std::uint32_t>(segmented->cloud.size());
  segmented->plants.push_back(plant);
  auto completed = std::make_shared<CompletedBlock>();
  completed->segmented = segmented;
  const std::vector<CanopyLayer> layers = canopyProfile({completed});
  ASSERT_GE(layers.size(), 20U);
  ASSERT_LE(layers.size(), 21U);
  EXPECT_EQ(layers[0].cover.value, 1.0);
  EXPECT_EQ(layers[5].cover.value, 1.0);
  EXPECT_EQ(layers[12].cover.value, 0.5);
  EXPECT_NEAR(layers[12].height, 1.2, 1e-9);
  EXPECT_NEAR(layers[12].cover.stddev, 0.5 / std::sqrt(40.0), 0.005);
  EXPECT_GT(layers[0].cover.stddev, 0.0);
  EXPECT_TRUE(canopyProfile({}).empty());
}

}  // namespace
}  // namespace field_phenotyping
