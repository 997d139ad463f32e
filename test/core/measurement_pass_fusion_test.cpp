// What is known of a plant that was passed several times.

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "field_phenotyping/measurement/pass_fusion.hpp"

namespace field_phenotyping {
namespace {

TEST(FuseTraits, WeighsByWhatEachKnows) {
  const Trait fused = fuseTraits({{1.0, 0.01}, {1.02, 0.02}});
  EXPECT_NEAR(fused.value, (1.0 / 1e-4 + 1.02 / 4e-4) / (1.0 / 1e-4 + 1.0 / 4e-4), 1e-12);
  EXPECT_NEAR(fused.stddev, 1.0 / std::sqrt(1.0 / 1e-4 + 1.0 / 4e-4), 1e-12);
}

TEST(FuseTraits, WidensWhereTheyDisagree) {
  const Trait fused = fuseTraits({{1.0, 0.01}, {1.1, 0.01}});
  EXPECT_NEAR(fused.value, 1.05, 1e-12);
  EXPECT_NEAR(fused.stddev, 0.05, 1e-12) << "half of what they differ by";
}

TEST(FuseTraits, LeavesOutWhatWasNotMeasured) {
  const Trait fused = fuseTraits({{}, {1.0, 0.01}, {2.0, std::nan("")}});
  EXPECT_EQ(fused.value, 1.0);
  EXPECT_NEAR(fused.stddev, 0.01, 1e-15);
  EXPECT_TRUE(std::isnan(fuseTraits({}).value));
  EXPECT_TRUE(std::isnan(fuseTraits({Trait(), Trait()}).stddev));
}

TEST(FuseTraits, CoversTheTruthAndKnowsMore) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const int passes : {2, 3, 5}) {
    int covered = 0;
    double stddevs = 0.0;
    double weights = 0.0;
    for (int k = 0; k < passes; ++k) weights += 1.0 / std::pow(0.0005 * (1 + k), 2);
    constexpr int kRounds = 20000;
    for (int round = 0; round < kRounds; ++round) {
      std::vector<Trait> traits;
      for (int k = 0; k < passes; ++k) {
        const double stddev = 0.0005 * (1 + k);
        traits.push_back({0.02 + stddev * normal(random), stddev});
      }
      const Trait fused = fuseTraits(traits);
      covered += std::abs(fused.value - 0.02) < 1.96 * fused.stddev ? 1 : 0;
      stddevs += fused.stddev;
    }
    EXPECT_GT(covered, 0.94 * kRounds) << passes;
    EXPECT_LT(covered, 0.985 * kRounds) << passes;
    EXPECT_LT(stddevs / kRounds, 1.2 / std::sqrt(weights)) << passes;
  }
}

Phenotype pass(double height, double diameter, std::uint32_t flags) {
  Phenotype plant;
  plant.id = 5;
  plant.height = {height, 0.01};
  plant.stem_diameter = {diameter, 0.001};
  plant.stem_diameter_minor = {0.9 * diameter, 0.001};
  plant.stem_diameter_equivalent = {0.95 * diameter, 0.001};
  plant.diameter_height = 0.7;
  plant.stem_points = 100U;
  plant.plant_points = 1000U;
  plant.arc_coverage = 0.6;
  plant.flags = flags;
  return plant;
}

TEST(FusePasses, DoubtfulValuesDoNotCountBesideClearOnes) {
  const Phenotype fused = fusePasses(
      {pass(1.5, 0.020, kTruncated), pass(1.8, 0.030, kArcBelow), pass(1.8, 0.020, kOk)});
  EXPECT_NEAR(fused.height.value, 1.8, 1e-12);
  EXPECT_NEAR(fused.stem_diameter.value, 0.020, 1e-12);
  EXPECT_EQ(fused.flags, kOk);
  EXPECT_EQ(fused.passes, 3U);
  EXPECT_EQ(fused.stem_points, 300U);
  EXPECT_EQ(fused.plant_points, 3000U);
}

TEST(FusePasses, DoubtThatAllPassesShareStays) {
  const Phenotype fused =
      fusePasses({pass(1.5, 0.020, kArcBelow | kTruncated), pass(1.5, 0.021, kArcBelow)});
  EXPECT_EQ(fused.flags, kArcBelow);
  EXPECT_NEAR(fused.stem_diameter.value, 0.0205, 1e-12);
}

TEST(FusePasses, AHeightThatIsCutOffDoesNotCount) {
  const Phenotype fused =
      fusePasses({pass(1.951, 0.020, kTruncated), pass(1.949, 0.020, kTruncated),
                  pass(0.948, 0.020, kOk), pass(std::nan(""), 0.020, kOk)});
  EXPECT_NEAR(fused.height.value, 1.95, 1e-12);
  EXPECT_LT(fused.height.stddev, 0.01);
  // A leaf of a neighbour may be taken for the plant's: which is right cannot be known.
  const Phenotype unlike = fusePasses({pass(1.5, 0.020, kOk), pass(1.7, 0.020, kOk)});
  EXPECT_NEAR(unlike.height.value, 1.6, 1e-12);
  EXPECT_GT(unlike.height.stddev, 0.05);
}

TEST(FusePasses, OnePassIsAsItWas) {
  const Phenotype one = pass(1.5, 0.02, kShortStem);
  const Phenotype fused = fusePasses({one});
  EXPECT_EQ(fused.height.value, one.height.value);
  EXPECT_EQ(fused.flags, one.flags);
  EXPECT_EQ(fused.passes, 1U);
}

TEST(FusePasses, TakesAMissingTraitFromThePassThatHasIt) {
  Phenotype without = pass(1.5, 0.02, kTooFewPoints);
  without.stem_diameter = without.stem_diameter_minor = without.stem_diameter_equivalent = {};
  without.diameter_height = std::nan("");
  const Phenotype fused = fusePasses({pass(1.5, 0.02, kOk), without});
  EXPECT_NEAR(fused.stem_diameter.value, 0.02, 1e-12);
  EXPECT_EQ(fused.diameter_height, 0.7);
  EXPECT_EQ(fused.flags, kOk);
  EXPECT_EQ(fused.score, qualityScore(fused));
}

}  // namespace
}  // namespace field_phenotyping
