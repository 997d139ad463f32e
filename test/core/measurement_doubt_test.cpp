// Which of a stand's diameters are doubted, where it is known which are wrong.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/measurement/diameter_doubt.hpp"

namespace field_phenotyping {
namespace {

constexpr double kMean = 0.022;

struct Drawn {
  std::vector<Trait> diameters;
  std::vector<double> truth;
};

/// Stems of a stand, measured with the error that they say but for a share of wrong fits.
Drawn drawStand(int count, double stddev, double wrong_share, double spread, std::uint32_t seed) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  Drawn drawn;
  for (int i = 0; i < count; ++i) {
    const double truth = kMean * (1.0 + spread * normal(engine));
    const double wrong = uniform(engine) < wrong_share ? 0.35 * kMean * normal(engine) : 0.0;
    drawn.truth.push_back(truth);
    drawn.diameters.push_back({truth + stddev * normal(engine) + wrong, stddev});
  }
  return drawn;
}

template <class Get>
double coverageOf(const Drawn& drawn, const Get& get) {
  double covered = 0.0;
  for (std::size_t i = 0; i < drawn.truth.size(); ++i) {
    const Trait diameter = get(i);
    if (std::abs(diameter.value - drawn.truth[i]) < 1.96 * diameter.stddev) covered += 1.0;
  }
  return covered / static_cast<double>(drawn.truth.size());
}

TEST(DiameterDoubt, CarriesWrongFitsInStandardDeviations) {
  for (const std::uint32_t seed : {1U, 2U, 3U}) {
    const Drawn drawn = drawStand(80, 0.002, 0.35, 0.08, seed);
    const std::vector<DiameterDoubt> doubts = doubtDiameters(drawn.diameters);
    EXPECT_LT(coverageOf(drawn, [&](std::size_t i) { return drawn.diameters[i]; }), 0.82);
    const double coverage = coverageOf(drawn, [&](std::size_t i) { return doubts[i].diameter; });
    EXPECT_GT(coverage, 0.90);
    for (std::size_t i = 0; i < doubts.size(); ++i) {
      EXPECT_EQ(doubts[i].diameter.value, drawn.diameters[i].value);
      EXPECT_GE(doubts[i].diameter.stddev, drawn.diameters[i].stddev);
      // Twice or half as thick as the others.
      if (std::abs(drawn.diameters[i].value - kMean) > 0.5 * kMean) {
        EXPECT_GT(doubts[i].wrong, 0.5);
      }
    }
  }
}

TEST(DiameterDoubt, LeavesHonestStandsAsTheyAre) {
  for (const double stddev : {0.0005, 0.002}) {
    for (const double spread : {0.04, 0.08, 0.20}) {
      const Drawn drawn = drawStand(60, stddev, 0.0, spread, 4U);
      for (const DiameterDoubt& doubt : doubtDiameters(drawn.diameters)) {
        EXPECT_LT(doubt.wrong, 0.1) << stddev << ' ' << spread;
        EXPECT_LT(doubt.diameter.stddev, 1.2 * stddev) << stddev << ' ' << spread;
      }
    }
  }
}

TEST(DiameterDoubt, OddPlantsThatAreWellMeasuredAreBelieved) {
  Drawn drawn = drawStand(60, 0.0006, 0.0, 0.08, 5U);
  for (std::size_t i = 0; i < drawn.diameters.size(); i += 5U) {
    drawn.diameters[i].value -= 0.4 * kMean;  // every fifth is a runt
  }
  for (const DiameterDoubt& doubt : doubtDiameters(drawn.diameters)) {
    EXPECT_LT(doubt.wrong, 0.1);
    EXPECT_LT(doubt.diameter.stddev, 0.0009);
  }
}

TEST(DiameterDoubt, PlotsOfTwoVarietiesAreNoneOfThemWrong) {
  Drawn drawn = drawStand(60, 0.001, 0.0, 0.06, 6U);
  for (std::size_t i = 0; i < drawn.diameters.size(); i += 2U) drawn.diameters[i].value -= 0.008;
  for (const DiameterDoubt& doubt : doubtDiameters(drawn.diameters)) EXPECT_LT(doubt.wrong, 0.1);
}

TEST(DiameterDoubt, FewStemsAndMissingOnesArePassedOn) {
  Drawn drawn = drawStand(5, 0.002, 0.0, 0.08, 7U);
  drawn.diameters[2].value = 2.0 * kMean;
  drawn.diameters.emplace_back();  // not measured
  const std::vector<DiameterDoubt> few = doubtDiameters(drawn.diameters);
  ASSERT_EQ(few.size(), 6U);
  for (std::size_t i = 0; i < 5U; ++i) {
    EXPECT_EQ(few[i].wrong, 0.0);
    EXPECT_EQ(few[i].diameter.stddev, drawn.diameters[i].stddev);
  }
  EXPECT_TRUE(std::isnan(few[5].diameter.value));

  drawn = drawStand(40, 0.002, 0.3, 0.08, 8U);
  drawn.diameters[3] = Trait();
  const std::vector<DiameterDoubt> many = doubtDiameters(drawn.diameters);
  ASSERT_EQ(many.size(), 40U);
  EXPECT_TRUE(std::isnan(many[3].diameter.value));
  EXPECT_EQ(many[3].wrong, 0.0);
  EXPECT_TRUE(doubtDiameters({}).empty());
}

}  // namespace
}  // namespace field_phenotyping
