// Traits of whole plants in a block, against exact truth.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numeric>
#include <random>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/measurement.hpp"
#include "field_phenotyping/measurement/plant_height.hpp"
#include "field_phenotyping/measurement/row_spacing.hpp"
#include "field_phenotyping/measurement/stem_coverage.hpp"
#include "field_phenotyping/measurement/stem_diameter.hpp"
#include "field_phenotyping/measurement/stem_population.hpp"

namespace field_phenotyping {
namespace {

constexpr double kDegree = M_PI / 180.0;

struct PlantTruth {
  Eigen::Vector2d base{1.0, 1.0};  // local
  double stem_length = 2.0;
  double diameter = 0.020;  // 2a at the soil, no taper
  double axis_ratio = 0.85;
  double angle = 0.5;
  double lean = 0.0;  // towards +x
  double noise = 0.003;
  int points_per_meter = 2000;
  double gap_low = 0.0, gap_high = 0.0;  // heights without stem points
};

/// Builds a block of straight stems on soil z = soil(x, y), in order.
class BlockBuilder {
 public:
  BlockBuilder() : block_(std::make_shared<SegmentedBlock>()) {
    block_->header.tile_size = 2.0;
    block_->header.revision = 7U;
    block_->header.final = true;
  }

  template <class Soil>
  BlockBuilder& soil(const Soil& height, float stddev = 0.004F, bool seen = true,
                     bool observed = true) {
    constexpr float kSpacing = 0.1F;
    constexpr int kNodes = 41;
    std::vector<GroundModel::Node> nodes;
    for (int j = 0; j < kNodes; ++j) {
      for (int i = 0; i < kNodes; ++i) {
        const float x = -1.0F + kSpacing * static_cast<float>(i);
        const float y = -1.0F + kSpacing * static_cast<float>(j);
        nodes.push_back(
            {static_cast<float>(height(x, y)), stddev, static_cast<std::uint8_t>(seen ? 1 : 0)});
      }
    }
    block_->ground =
        GroundModel({-1.0F, -1.0F}, kSpacing, kNodes, kNodes, std::move(nodes), observed);
    return *this;
  }

  BlockBuilder& origin(const Eigen::Vector3d& origin) {
    block_->cloud.origin = origin;
    block_->header.index.x = static_cast<std::int32_t>(std::floor((origin.x() + 1.0) / 2.0));
    block_->header.index.y = static_cast<std::int32_t>(std::floor((origin.y() + 1.0) / 2.0));
    return *this;
  }

  BlockBuilder& plant(const PlantTruth& truth, std::uint32_t seed, bool owned = true) {
    std::mt19937 engine(seed);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform;
    const float soil = block_->ground.heightAt(static_cast<float>(truth.base.x()),
                                               static_cast<float>(truth.base.y()));
    const Eigen::Vector3d base(truth.base.x(), truth.base.y(), soil);
    const Eigen::Vector3d along(std::sin(truth.lean), 0.0, std::cos(truth.lean));
    const Eigen::Vector3d across(std::cos(truth.lean), 0.0, -std::sin(truth.lean));
    const Eigen::Vector3d side = Eigen::Vector3d::UnitY();
    Plant plant;
    plant.id = static_cast<std::int32_t>(block_->plants.size());
    plant.owned = owned;
    plant.base = base.cast<float>();
    plant.growth.quality = 0.9F;
    plant.points.begin = plant.stem.begin = static_cast<std::uint32_t>(block_->cloud.size());
    const int count = static_cast<int>(truth.points_per_meter * truth.stem_length);
    const double a = 0.5 * truth.diameter;
    const double b = truth.axis_ratio * a;
    for (int i = 0; i < count; ++i) {
      const double h = truth.stem_length * uniform(engine);
      const double t = 2.0 * M_PI * uniform(engine);
      const double u = a * std::cos(t), v = b * std::sin(t);
      const double c = std::cos(truth.angle), s = std::sin(truth.angle);
      const Eigen::Vector3d noise(normal(engine), normal(engine), normal(engine));
      if (h > truth.gap_low && h < truth.gap_high) continue;
      add(base + h * along + (c * u - s * v) * across + (s * u + c * v) * side +
          truth.noise * noise);
    }
    plant.stem.end = plant.points.end = static_cast<std::uint32_t>(block_->cloud.size());
    std::vector<StemAxis::Node> nodes(5);
    for (std::size_t k = 0; k < nodes.size(); ++k) {
      const double h = truth.stem_length * static_cast<double>(k) / 4.0;
      nodes[k].position = (base + h * along).cast<float>();
      nodes[k].radius = static_cast<float>(0.5 * (a + b));
    }
    plant.axis = StemAxis(nodes);
    block_->plants.push_back(plant);
    return *this;
  }

  /// Points of other organs, given to the plant added last.
  BlockBuilder& organ(const std::vector<Eigen::Vector3d>& points) {
    for (const Eigen::Vector3d& point : points) add(point);
    block_->plants.back().points.end = static_cast<std::uint32_t>(block_->cloud.size());
    return *this;
  }

  SegmentedBlock& block() { return *block_; }

  CompletedBlock completed() const {
    CompletedBlock completed;
    completed.segmented = block_;
    completed.synthetic_span.resize(block_->plants.size());
    return completed;
  }

 private:
  void add(const Eigen::Vector3d& point) { block_->cloud.points.push_back(point.cast<float>()); }

  std::shared_ptr<SegmentedBlock> block_;
};

Phenotype measureOne(const BlockBuilder& builder,
                     const MeasurementParameters& parameters = MeasurementParameters()) {
  const std::vector<Phenotype> phenotypes = measureBlock(builder.completed(), parameters);
  EXPECT_EQ(phenotypes.size(), 1U);
  return phenotypes.empty() ? Phenotype() : phenotypes.front();
}

const auto kFlat = [](float, float) { return 0.0; };

TEST(Measurement, UprightPlantOnFlatSoil) {
  BlockBuilder builder;
  builder.soil(kFlat).plant(PlantTruth(), 1U);
  const Phenotype p = measureOne(builder);
  EXPECT_EQ(flagNames(p.flags), "ok");
  EXPECT_EQ(p.revision, 7U);
  EXPECT_TRUE(p.final);
  EXPECT_NEAR(p.height.value, 2.0, 0.015);
  EXPECT_GE(p.height.stddev, 0.004);
  EXPECT_LT(p.height.stddev, 0.02);
  EXPECT_NEAR(p.stem_diameter.value, 0.020, 0.0015);
  EXPECT_NEAR(p.stem_diameter_minor.value, 0.017, 0.0015);
  EXPECT_NEAR(p.stem_diameter_equivalent.value, std::sqrt(0.020 * 0.017), 0.0010);
  EXPECT_GT(p.stem_diameter.stddev, 0.0);
  EXPECT_LT(p.stem_diameter.stddev, 0.002);
  EXPECT_DOUBLE_EQ(p.diameter_height, 0.7);
  EXPECT_NEAR(p.lean.value, 0.0, 1e-6);
  EXPECT_GT(p.lean.stddev, 0.0);
  EXPECT_GT(p.arc_coverage, 0.95);
  EXPECT_GT(p.completeness, 0.8);
  EXPECT_EQ(p.stem_points, p.plant_points);
  EXPECT_GT(p.diameter_points, 200U);
  EXPECT_TRUE(std::isnan(p.spacing.value));
}

TEST(Measurement, DiametersOfManyPlantsWithinThreeMillimetres) {
  double squares = 0.0;
  int covered = 0;
  constexpr int kPlants = 60;
  for (std::uint32_t seed = 0; seed < kPlants; ++seed) {
    std::mt19937 engine(seed + 1000U);
    std::uniform_real_distribution<double> uniform;
    PlantTruth truth;
    truth.diameter = 0.016 + 0.010 * uniform(engine);
    truth.axis_ratio = 0.80 + 0.15 * uniform(engine);
    truth.angle = M_PI * uniform(engine);
    truth.lean = 10.0 * kDegree * uniform(engine);
    truth.points_per_meter = 300;  // 45 in the span
    BlockBuilder builder;
    builder.soil(kFlat).plant(truth, seed);
    const Phenotype p = measureOne(builder);
    ASSERT_TRUE(std::isfinite(p.stem_diameter.value)) << flagNames(p.flags);
    const double error = p.stem_diameter.value - truth.diameter;
    squares += error * error;
    covered += std::abs(error) < 1.96 * p.stem_diameter.stddev ? 1 : 0;
  }
  std::printf("45 points, noise 3 mm: RMSE %.2f mm, coverage %.2f\n",
              1e3 * std::sqrt(squares / kPlants), static_cast<double>(covered) / kPlants);
  EXPECT_LT(std::sqrt(squares / kPlants), 0.0020);
  EXPECT_GE(covered, 50);
}

TEST(Measurement, LeaningPlantIsCutAcrossItsAxis) {
  PlantTruth truth;
  truth.lean = 15.0 * kDegree;
  truth.noise = 0.001;
  truth.angle = 0.0;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 2U);
  const Phenotype p = measureOne(builder);
  EXPECT_NEAR(p.lean.value, truth.lean, 2.0 * p.lean.stddev);
  EXPECT_NEAR(p.lean_azimuth, 0.0, 1e-3);
  EXPECT_NEAR(p.axis.x(), std::sin(truth.lean), 1e-3);
  EXPECT_NEAR(p.stem_diameter.value, truth.diameter, 5e-4);
  EXPECT_NEAR(p.height.value, truth.stem_length * std::cos(truth.lean), 0.012);
}

TEST(Measurement, HeightIsVerticalFromTheSoilAtTheBase) {
  const auto slope = [](float x, float y) { return 0.2 * x - 0.1 * y + 0.3; };
  const auto ridges = [](float x, float) { return x > 0.75F && x < 1.25F ? 0.12 : 0.0; };
  for (int kind = 0; kind < 2; ++kind) {
    BlockBuilder builder;
    if (kind == 0) {
      builder.soil(slope);
    } else {
      builder.soil(ridges);
    }
    builder.plant(PlantTruth(), 3U);
    // A leaf whose tip hangs far out, lower than the top, over lower soil.
    builder.organ({{1.4, 1.0, 1.2}, {1.5, 1.0, 1.1}});
    const Phenotype p = measureOne(builder);
    EXPECT_NEAR(p.height.value, 2.0, 0.015) << kind;
    EXPECT_EQ(p.flags & (kGroundMissing | kGroundExtrapolated), 0U);
  }
}

TEST(Measurement, TopOfAnyOrganCountsAndSparseTipsAreUncertain) {
  BlockBuilder builder;
  builder.soil(kFlat).plant(PlantTruth(), 4U);
  // A tassel of 2.3 m, a return every 4 cm.
  builder.organ({{1, 1, 2.04},
                 {1, 1, 2.08},
                 {1, 1, 2.12},
                 {1, 1, 2.16},
                 {1, 1, 2.20},
                 {1, 1, 2.24},
                 {1, 1, 2.28}});
  const Phenotype p = measureOne(builder);
  EXPECT_NEAR(p.height.value, 2.3, 0.025);
  EXPECT_GT(p.height.stddev, 0.03);
  MeasurementParameters paper;
  paper.mode = "paper";
  EXPECT_NEAR(measureOne(builder, paper).height.value, 2.28, 1e-3);
}

/// Plants of 2.3 m whose spikes are met by a beam about every 4 cm, by chance.
BlockBuilder standOfSparseTips(int plants, std::uint32_t seed) {
  BlockBuilder builder;
  builder.soil(kFlat, 0.002F);
  std::mt19937 engine(seed);
  std::exponential_distribution<double> gap(1.0 / 0.04);
  PlantTruth truth;
  truth.points_per_meter = 40;
  for (int k = 0; k < plants; ++k) {
    builder.plant(truth, seed + static_cast<std::uint32_t>(k));
    std::vector<Eigen::Vector3d> spike;
    for (double z = 2.3 - gap(engine); z > 2.0; z -= gap(engine)) spike.push_back({1.0, 1.0, z});
    builder.organ(spike);
  }
  return builder;
}

TEST(Measurement, WhatTheBeamsMissOfATipIsLearntFromTheWholeBlock) {
  constexpr int kBlocks = 150, kPlants = 16;
  double sum = 0.0, squares = 0.0, covered = 0.0;
  for (std::uint32_t block = 0; block < kBlocks; ++block) {
    BlockBuilder builder = standOfSparseTips(kPlants, 100U * block);
    const auto heights = measurePlantHeights(builder.block(), {}, 0.003);
    ASSERT_EQ(heights.size(), static_cast<std::size_t>(kPlants));
    for (const PlantHeight& plant : heights) {
      const double error = plant.height.value - 2.3;
      sum += error;
      squares += error * error;
      covered += std::abs(error) < 1.96 * plant.height.stddev ? 1.0 : 0.0;
    }
  }
  constexpr double kAll = kBlocks * kPlants;
  EXPECT_NEAR(sum / kAll, 0.0, 0.003);
  // The miss itself is spread by 0.04 m; with the spacings of one plant it would be 0.045 m.
  EXPECT_LT(std::sqrt(squares / kAll), 0.042);
  EXPECT_GT(covered / kAll, 0.92);
  EXPECT_LT(covered / kAll, 0.98);
}

TEST(Measurement, TipsThatPointsThinOutTowardsGoOnFartherThanTheSpacingsSay) {
  // As of a leaf: twice as far from its tip there are four times as many points up to there.
  constexpr int kBlocks = 40, kPlants = 60;
  constexpr double kFirst = 0.012;  // [m] up to where one point is expected
  double sum = 0.0, covered = 0.0;
  for (std::uint32_t block = 0; block < kBlocks; ++block) {
    BlockBuilder builder;
    builder.soil(kFlat, 0.002F);
    std::mt19937 engine(block);
    std::exponential_distribution<double> more;
    PlantTruth truth;
    truth.points_per_meter = 40;
    for (int k = 0; k < kPlants; ++k) {
      builder.plant(truth, 100U * block + static_cast<std::uint32_t>(k));
      std::vector<Eigen::Vector3d> leaf;
      for (double points = more(engine); points < 400.0; points += more(engine)) {
        leaf.push_back({1.0, 1.0, 2.3 - kFirst * std::sqrt(points)});
      }
      builder.organ(leaf);
    }
    for (const PlantHeight& plant : measurePlantHeights(builder.block(), {}, 0.0005)) {
      const double error = plant.height.value - 2.3;
      sum += error;
      covered += std::abs(error) < 1.96 * plant.height.stddev ? 1.0 : 0.0;
    }
  }
  constexpr double kAll = kBlocks * kPlants;
  // The tip is 0.0106 m beyond the highest point, and the highest spacings are 0.0042 m: with those
  // alone 0.0064 m would be missing. Sixty plants do not outweigh that most tips are even.
  EXPECT_NEAR(sum / kAll, 0.0, 0.0035);
  EXPECT_GT(covered / kAll, 0.92);
}

TEST(Measurement, APointFarAboveAPlantMakesItsHeightUncertainAndNoOthers) {
  BlockBuilder builder = standOfSparseTips(16, 7U);
  const auto before = measurePlantHeights(builder.block(), {}, 0.003);
  builder.organ({{1.0, 1.0, 3.3}});
  const auto after = measurePlantHeights(builder.block(), {}, 0.003);
  EXPECT_GT(after.back().height.stddev, 0.2);
  for (std::size_t k = 0; k + 1U < after.size(); ++k) {
    EXPECT_NEAR(after[k].height.value, before[k].height.value, 0.01);
    EXPECT_NEAR(after[k].height.stddev, before[k].height.stddev, 0.01);
  }
}

TEST(Measurement, ATopAboutWhichHardlyAnythingIsSeenMakesTheHeightUncertain) {
  const auto measured = [](double spacing) {
    BlockBuilder builder;
    builder.soil(kFlat, 0.002F).plant(PlantTruth(), 5U);
    std::vector<Eigen::Vector3d> spike;
    for (double z = 2.3; z > 2.0; z -= spacing) spike.push_back({1.0, 1.0, z});
    builder.organ(spike);
    return measurePlantHeights(builder.block(), {}, 0.003).front().height;
  };
  // The highest point has so many neighbours below it, within 4 cm.
  EXPECT_LT(measured(0.002).stddev, 0.012);
  EXPECT_GT(measured(0.05).stddev, 0.1);
  EXPECT_LT(measured(0.05).stddev, 0.15);
}

TEST(Measurement, MissingSoilIsFlagged) {
  BlockBuilder missing;
  missing.soil(kFlat, 0.004F, false, false).plant(PlantTruth(), 5U);
  missing.block().plants[0].base.z() = 0.05F;
  const Phenotype cropped = measureOne(missing);
  EXPECT_TRUE(cropped.flags & kGroundMissing);
  EXPECT_NEAR(cropped.height.value, 2.0, 0.02);
  EXPECT_GT(cropped.height.stddev, 0.0);

  BlockBuilder unseen;
  unseen.soil(kFlat, 0.05F, false, true).plant(PlantTruth(), 5U);
  const Phenotype extrapolated = measureOne(unseen);
  EXPECT_TRUE(extrapolated.flags & kGroundExtrapolated);
  EXPECT_GE(extrapolated.height.stddev, 0.05);
}

TEST(Measurement, TooFewPointsGiveNoDiameterButAReason) {
  PlantTruth truth;
  truth.points_per_meter = 6;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 6U);
  const Phenotype p = measureOne(builder);
  EXPECT_TRUE(std::isnan(p.stem_diameter.value));
  EXPECT_TRUE(std::isnan(p.stem_diameter.stddev));
  EXPECT_TRUE(p.flags & kTooFewPoints);
  EXPECT_TRUE(std::isfinite(p.height.value));
}

TEST(Measurement, PlantWithoutStemOrPointsIsReportedEmpty) {
  BlockBuilder builder;
  builder.soil(kFlat);
  Plant plant;
  plant.base = {1.0F, 1.0F, 0.0F};
  builder.block().plants.push_back(plant);
  const Phenotype p = measureOne(builder);
  EXPECT_TRUE(std::isnan(p.height.value));
  EXPECT_TRUE(std::isnan(p.stem_diameter.value));
  EXPECT_TRUE(std::isnan(p.lean.value));
  EXPECT_TRUE(std::isnan(p.completeness));
  EXPECT_TRUE(p.flags & kTooFewPoints);
  EXPECT_TRUE(p.flags & kLowConfidence);
}

TEST(Measurement, SaysHowTheStemWasGrown) {
  BlockBuilder builder;
  builder.soil(kFlat).plant(PlantTruth(), 12U);
  GrowthSummary& growth = builder.block().plants[0].growth;
  growth.iterations = 3U;
  growth.r1 = 0.05F;
  growth.M = 0.45F;
  growth.alpha = 0.25F;
  growth.beta = 0.85F;
  const Phenotype p = measureOne(builder);
  EXPECT_EQ(p.segmentation_quality, 0.9F);
  EXPECT_EQ(p.growth_iterations, 3U);
  EXPECT_EQ(p.growth_r1, 0.05F);
  EXPECT_EQ(p.growth_M, 0.45F);
  EXPECT_EQ(p.growth_alpha, 0.25F);
  EXPECT_EQ(p.growth_beta, 0.85F);
}

TEST(Measurement, HiddenMeasuringHeightIsShiftedAndSaysSo) {
  PlantTruth truth;
  truth.gap_low = 0.45;
  truth.gap_high = 0.95;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 7U);
  const Phenotype p = measureOne(builder);
  EXPECT_TRUE(p.flags & kHeightShifted);
  EXPECT_DOUBLE_EQ(p.diameter_height, 0.7);
  EXPECT_NEAR(p.stem_diameter.value, truth.diameter, 0.003);
}

TEST(Measurement, HardlySeenStemsAreMeasuredOverALongerPiece) {
  constexpr std::uint32_t kStems = 60U;
  MeasurementParameters near;
  near.max_shift = 0.0;
  PlantTruth truth;
  truth.points_per_meter = 30;
  double shorter = 0.0, longer = 0.0, covered = 0.0;  // squared errors [m^2]
  for (std::uint32_t k = 0; k < kStems; ++k) {
    BlockBuilder builder;
    builder.soil(kFlat).plant(truth, k);
    const Phenotype by_few = measureOne(builder, near);
    const Phenotype by_more = measureOne(builder);
    const double error = by_more.stem_diameter.value - truth.diameter;
    shorter += std::pow(by_few.stem_diameter.value - truth.diameter, 2);
    longer += error * error;
    covered += std::abs(error) < 1.96 * by_more.stem_diameter.stddev ? 1.0 : 0.0;
  }
  std::printf("diameter RMSE, 0.9 m of stem: %.2f mm; 1.5 m: %.2f mm, coverage %.2f\n",
              1e3 * std::sqrt(shorter / kStems), 1e3 * std::sqrt(longer / kStems),
              covered / kStems);
  EXPECT_LT(longer, 0.7 * shorter);
  EXPECT_GT(covered / kStems, 0.85);
}

TEST(Measurement, ShortStemsAreMeasuredLower) {
  PlantTruth truth;
  truth.stem_length = 0.5;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 8U);
  const Phenotype p = measureOne(builder);
  EXPECT_TRUE(p.flags & kShortStem);
  EXPECT_NEAR(p.diameter_height, 0.2, 1e-6);
}

TEST(Measurement, FarFromTheOriginChangesNothing) {
  BlockBuilder near;
  near.soil(kFlat).plant(PlantTruth(), 9U);
  BlockBuilder far;
  const Eigen::Vector3d origin(448000.0, 5411000.0, 90.0);
  far.origin(origin).soil(kFlat).plant(PlantTruth(), 9U);
  const Phenotype a = measureOne(near);
  const Phenotype b = measureOne(far);
  EXPECT_EQ(a.stem_diameter.value, b.stem_diameter.value);
  EXPECT_EQ(a.height.value, b.height.value);
  EXPECT_NEAR((b.base - a.base - origin).norm(), 0.0, 1e-6);
  EXPECT_EQ(a.flags, b.flags);
}

TEST(Measurement, ThreadCountChangesNothing) {
  BlockBuilder builder;
  builder.soil(kFlat);
  for (std::uint32_t i = 0; i < 8U; ++i) {
    PlantTruth truth;
    truth.base = {0.2 + 0.2 * i, 1.0};
    builder.plant(truth, i, i != 3U);
  }
  const auto run = [&](int threads) {
    const ThreadLimit limit(threads);
    return measureBlock(builder.completed(), MeasurementParameters());
  };
  const std::vector<Phenotype> one = run(1);
  const std::vector<Phenotype> many = run(4);
  ASSERT_EQ(one.size(), 7U);  // the plant of another block is not reported
  for (std::size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].id, many[i].id);
    EXPECT_EQ(one[i].stem_diameter.value, many[i].stem_diameter.value);
    EXPECT_EQ(one[i].stem_diameter.stddev, many[i].stem_diameter.stddev);
    EXPECT_EQ(one[i].height.value, many[i].height.value);
  }
}

TEST(Measurement, BorderAndWeakEvidenceAreFlagged) {
  BlockBuilder builder;
  builder.soil(kFlat).plant(PlantTruth(), 10U);
  builder.organ({{2.595, 1.0, 1.0}});  // tile [0, 2) and a margin of 0.6
  builder.block().plants[0].growth.quality = 0.1F;
  const Phenotype p = measureOne(builder);
  EXPECT_EQ(flagNames(p.flags), "truncated|low_confidence");
}

TEST(RowSpacing, NextPlantAlongTheRowWhateverItsDirection) {
  for (const double azimuth : {0.0, 35.0, 90.0, 150.0}) {
    BlockBuilder builder;
    builder.soil(kFlat);
    const Eigen::Vector2d along(std::cos(azimuth * kDegree), std::sin(azimuth * kDegree));
    const Eigen::Vector2d across(-along.y(), along.x());
    for (int row = 0; row < 2; ++row) {
      for (int i = 0; i < 6; ++i) {
        if (row == 0 && i == 2) continue;  // a gap
        PlantTruth truth;
        truth.points_per_meter = 10;
        truth.base = 0.2 * i * along + 0.75 * row * across;
        builder.plant(truth, 1U, row == 0);
      }
    }
    const std::vector<PlantSpacing> spacings = measureRowSpacing(builder.block());
    std::vector<Trait> spacing;
    for (const PlantSpacing& one : spacings) {
      spacing.push_back(one.in_row);
      EXPECT_NEAR(one.to_row.value, 0.75, 1e-5) << azimuth;
      EXPECT_GT(one.to_row.stddev, 0.0);
      EXPECT_LT(one.to_row.stddev, 0.02);
    }
    // Rows at 150 degrees run towards positive x the other way round.
    const bool reversed = azimuth > 135.0;
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::vector<double> expected = reversed ? std::vector<double>{nan, 0.2, 0.4, 0.2, 0.2}
                                                  : std::vector<double>{0.2, 0.4, 0.2, 0.2, nan};
    for (std::size_t i = 0; i < expected.size(); ++i) {
      if (std::isnan(expected[i])) {
        EXPECT_TRUE(std::isnan(spacing[i].value)) << azimuth << " " << i;
      } else {
        EXPECT_NEAR(spacing[i].value, expected[i], 1e-5) << azimuth << " " << i;
        EXPECT_GT(spacing[i].stddev, 0.0);
      }
    }
  }
}

TEST(RowSpacing, NoneWithoutARow) {
  BlockBuilder builder;
  builder.soil(kFlat).plant(PlantTruth(), 1U);
  EXPECT_TRUE(std::isnan(measureRowSpacing(builder.block())[0].in_row.value));
  EXPECT_TRUE(std::isnan(measureRowSpacing(builder.block())[0].to_row.value));
}

TEST(RowSpacing, OneRowHasNoNeighbour) {
  BlockBuilder builder;
  builder.soil(kFlat);
  for (std::uint32_t i = 0; i < 6U; ++i) {
    PlantTruth truth;
    truth.points_per_meter = 10;
    truth.base = {0.2 + 0.2 * i, 1.0};
    builder.plant(truth, i);
  }
  for (const PlantSpacing& spacing : measureRowSpacing(builder.block())) {
    EXPECT_TRUE(std::isnan(spacing.to_row.value));
  }
}

/// Ten stems in a row; `odd` stands in for the first of them.
std::vector<Phenotype> measureRow(const PlantTruth& odd, bool doubled,
                                  const MeasurementParameters& parameters = {}) {
  BlockBuilder builder;
  builder.soil(kFlat);
  for (std::uint32_t i = 0; i < 10U; ++i) {
    PlantTruth truth = i == 0U ? odd : PlantTruth();
    truth.points_per_meter = 300;
    truth.base = {0.1 + 0.19 * i, 1.0};
    builder.plant(truth, i);
    if (i == 0U && doubled) {  // the points of a second stem, 2 cm beside it, are its stem's too
      BlockBuilder second;
      truth.base.y() += 0.02;
      second.soil(kFlat).plant(truth, 99U);
      std::vector<Eigen::Vector3d> points;
      for (const Eigen::Vector3f& point : second.block().cloud.points) {
        points.push_back(point.cast<double>());
      }
      builder.organ(points);
      Plant& plant = builder.block().plants[0];
      plant.stem.end = plant.points.end;
    }
  }
  return measureBlock(builder.completed(), parameters);
}

TEST(Measurement, RoughFitsUnlikeTheOthersOfTheirBlockAreKnownLessWell) {
  // Of every third stem of 20 mm a few noisy points that lie round 34 mm: of neighbours, say.
  MeasurementParameters few;
  few.max_shift = 0.0;
  BlockBuilder builder;
  builder.soil(kFlat);
  const auto isWrong = [](std::uint32_t i) { return i % 3U == 0U; };
  for (std::uint32_t i = 0; i < 15U; ++i) {
    PlantTruth truth;
    truth.points_per_meter = isWrong(i) ? 60 : 600;
    truth.noise = isWrong(i) ? 0.006 : 0.003;
    truth.diameter = isWrong(i) ? 0.034 : 0.020;
    truth.base = {0.1 + 0.13 * i, 1.0};
    builder.plant(truth, i);
  }
  const std::vector<Phenotype> plants = measureBlock(builder.completed(), few);
  ASSERT_EQ(plants.size(), 15U);
  for (std::uint32_t i = 0; i < plants.size(); ++i) {
    const Trait& major = plants[i].stem_diameter;
    // Each is said to be unlike the others, or is so little known that these carry it.
    EXPECT_EQ((plants[i].flags & (kUnlikeStand | kPriorDriven)) != 0U, isWrong(i)) << i;
    if (isWrong(i)) {
      EXPECT_GT(major.value, 0.026) << i << ": values stay nearly as they are";
      EXPECT_LT(std::abs(major.value - 0.020), 1.96 * major.stddev) << i;
      EXPECT_GT(plants[i].stem_diameter_equivalent.stddev, 0.004) << i;
    } else {
      EXPECT_LT(major.stddev, 0.002) << i;
    }
  }
}

TEST(Measurement, WhatPriorsDecideMayBeWrongForAllStemsAlike) {
  BlockBuilder builder;
  builder.soil(kFlat);
  for (std::uint32_t i = 0; i < 12U; ++i) {
    PlantTruth truth;
    truth.points_per_meter = i % 2U == 0U ? 18 : 600;
    truth.base = {0.1 + 0.15 * i, 1.0};
    builder.plant(truth, i);
  }
  const CompletedBlock completed = builder.completed();
  const SegmentedBlock& block = *completed.segmented;
  const MeasurementParameters parameters;
  std::vector<std::size_t> all(block.plants.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  const CrossSectionPrior weak = weakPrior(parameters);
  const std::vector<StemDiameter> alone =
      measureStemDiameters(block, all, parameters, weak, {}, {});
  std::vector<StemCrossSection> fits;
  for (const StemDiameter& stem : alone) fits.push_back(stem.section);
  const CrossSectionPrior prior = populationPrior(fits, weak, PopulationPrior::kShape);
  const std::vector<StemDiameter> together =
      measureStemDiameters(block, all, parameters, prior, alone, {});
  const std::vector<Phenotype> plants = measureBlock(completed, parameters);
  ASSERT_EQ(plants.size(), together.size());
  double most = 0.0;
  for (std::size_t i = 0; i < plants.size(); ++i) {
    const double alike = 2.0 * prior.radius_alike_stddev * together[i].prior_share;
    const double stddev = std::hypot(together[i].major.stddev, alike);
    EXPECT_GE(plants[i].stem_diameter.stddev, 0.999 * stddev) << i;
    EXPECT_LT(plants[i].stem_diameter.stddev, 1.1 * stddev) << i;
    most = std::max(most, stddev / together[i].major.stddev);
  }
  EXPECT_GT(most, 1.001);
}

TEST(Measurement, TwoStemsTakenForOneAreSuspected) {
  const std::vector<Phenotype> plain = measureRow(PlantTruth(), false);
  const std::vector<Phenotype> doubled = measureRow(PlantTruth(), true);
  for (std::size_t i = 0; i < plain.size(); ++i) {
    EXPECT_FALSE(plain[i].flags & kMergedSuspect) << i;
    EXPECT_EQ((doubled[i].flags & kMergedSuspect) != 0U, i == 0U) << i;
    EXPECT_GT(plain[i].score, 0.8) << i;
    EXPECT_LE(plain[i].score, 1.0) << i;
  }
  EXPECT_LT(doubled[0].score, 0.5 * plain[0].score);
}

TEST(Measurement, BlockPriorsAreSwitchableAndTheirWeightIsReported) {
  PlantTruth thick;
  thick.diameter = 0.026;
  MeasurementParameters parameters;
  const Phenotype shape = measureRow(thick, false, parameters)[0];
  parameters.block_diameter_prior = true;
  const Phenotype size = measureRow(thick, false, parameters)[0];
  parameters.block_shape_prior = false;
  const Phenotype alone = measureRow(thick, false, parameters)[0];
  EXPECT_LT(shape.diameter_prior_share, 0.1);
  EXPECT_GT(size.diameter_prior_share, shape.diameter_prior_share);
  EXPECT_LT(size.diameter_prior_share, 0.5);
  EXPECT_LT(size.stem_diameter.value, shape.stem_diameter.value);  // towards the others
  EXPECT_LT(shape.stem_diameter.stddev, alone.stem_diameter.stddev);
  EXPECT_NEAR(shape.stem_diameter.value, thick.diameter, 0.0015);
}

TEST(Measurement, LittleSeenStemsAreOfTheirStandAndSaySo) {
  // Stems as seedlings have them, of 20 points or so. One is half as thick again as the others,
  // once as little seen as they are, once seen well.
  for (const bool well_seen : {false, true}) {
    BlockBuilder builder;
    builder.soil(kFlat);
    constexpr std::uint32_t kPlants = 30U;
    for (std::uint32_t i = 0; i < kPlants; ++i) {
      PlantTruth truth;
      truth.stem_length = 0.16;
      truth.points_per_meter = 200;
      truth.diameter = 0.010;
      truth.noise = 0.002;
      if (i == 0U) {
        truth.diameter = 0.015;
        if (well_seen) truth.points_per_meter = 10000;
      }
      truth.base = {0.1 + 0.06 * i, 1.0};
      builder.plant(truth, i);
    }
    const std::vector<Phenotype> plants = measureBlock(builder.completed(), {});
    ASSERT_EQ(plants.size(), kPlants);
    double sum = 0.0, squares = 0.0;
    int covered = 0, measured = 0;
    for (std::uint32_t i = 1U; i < kPlants; ++i) {
      const Trait& major = plants[i].stem_diameter;
      if (std::isnan(major.value)) continue;
      ++measured;
      const double error = major.value - 0.010;
      sum += error;
      squares += error * error;
      if (std::abs(error) < 1.96 * major.stddev) ++covered;
      EXPECT_GT(plants[i].diameter_prior_share, 0.1) << i;
    }
    EXPECT_GT(measured, 24);
    EXPECT_LT(std::abs(sum / measured), 0.4e-3);
    EXPECT_LT(std::sqrt(squares / measured), 1.2e-3);
    EXPECT_GT(covered, 0.9 * measured);
    const Trait& odd = plants[0].stem_diameter;
    EXPECT_LT(std::abs(odd.value - 0.015), 1.96 * odd.stddev);
    if (well_seen) {
      EXPECT_NEAR(odd.value, 0.015, 0.5e-3);
    }
  }
}

TEST(Measurement, VolumeOfTheStemBelowTheMeasuringHeight) {
  PlantTruth truth;
  truth.lean = 10.0 * kDegree;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 14U);
  const Phenotype p = measureOne(builder);
  const double expected = 0.25 * M_PI * truth.axis_ratio * truth.diameter * truth.diameter *
                          p.diameter_height / std::cos(truth.lean);
  EXPECT_NEAR(p.stem_volume.value, expected, 2.0 * p.stem_volume.stddev);
  EXPECT_GT(p.stem_volume.stddev, 0.03 * expected);
  EXPECT_LT(p.stem_volume.stddev, 0.10 * expected);
}

TEST(Score, FallsWithEachReasonToDoubt) {
  Phenotype p;
  EXPECT_EQ(qualityScore(p), 0.0);
  p.segmentation_quality = 0.9F;
  p.stem_diameter = {0.02, 0.0005};
  p.height = {2.0, 0.01};
  p.arc_coverage = 1.0;
  const double good = qualityScore(p);
  EXPECT_GT(good, 0.9);
  EXPECT_LE(good, 1.0);
  p.flags = kShortStem;  // says nothing of the trust
  EXPECT_EQ(qualityScore(p), good);
  for (const QualityFlag flag : {kPoorFit, kPriorDriven, kGroundMissing}) {
    p.flags = flag;
    EXPECT_DOUBLE_EQ(qualityScore(p), 0.5 * good);
  }
  p.flags = kMergedSuspect;
  EXPECT_DOUBLE_EQ(qualityScore(p), 0.4 * good);
  p.flags = kArcBelow;
  EXPECT_DOUBLE_EQ(qualityScore(p), 0.8 * good);
  p.flags = kOk;
  p.stem_diameter.stddev = 0.002;
  EXPECT_NEAR(qualityScore(p), 0.5, 0.02);
  p.stem_diameter = {};
  EXPECT_LT(qualityScore(p), 0.3);
  EXPECT_GT(qualityScore(p), 0.0);
}

TEST(Coverage, ArcHasGapsTakenOut) {
  std::vector<double> half;
  for (int i = 0; i <= 18; ++i) half.push_back(i * 10.0 * kDegree);
  EXPECT_NEAR(arcCoverage(half), 0.5, 1e-9);
  half.push_back(270.0 * kDegree);  // one stray point does not close the gap
  EXPECT_NEAR(arcCoverage(half), 0.5, 1e-9);
  EXPECT_EQ(arcCoverage({}), 0.0);
}

TEST(Coverage, CompletenessFollowsTheMissingShare) {
  PlantTruth truth;
  truth.noise = 0.0;
  truth.points_per_meter = 20000;
  truth.gap_low = 0.5;
  truth.gap_high = 1.0;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 11U);
  EXPECT_NEAR(stemCompleteness(builder.block(), builder.block().plants[0]), 0.75, 0.01);
}

TEST(PaperMode, DiameterByEq27AsPrinted) {
  PlantTruth truth;
  truth.noise = 0.0005;
  BlockBuilder builder;
  builder.soil(kFlat).plant(truth, 12U);
  MeasurementParameters paper;
  paper.mode = "paper";
  const Phenotype p = measureOne(builder, paper);
  EXPECT_NEAR(p.stem_diameter.value, truth.diameter, 6e-4);
  EXPECT_GT(p.stem_diameter.value, truth.diameter);
  EXPECT_GT(p.stem_diameter.stddev, 0.0);
}

TEST(Flags, HaveNames) {
  EXPECT_EQ(flagNames(kOk), "ok");
  EXPECT_EQ(flagNames(kTooFewPoints | kPriorDriven), "too_few_points|prior_driven");
  EXPECT_EQ(flagNames(kMergedSuspect), "merged_suspect");
  EXPECT_EQ(flagNames(kUnlikeStand), "unlike_stand");
}

}  // namespace
}  // namespace field_phenotyping
