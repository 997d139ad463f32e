// The length that the stems of a stand have in common, and how well they are seen.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <utility>
#include <vector>

#include "field_phenotyping/segmentation/sampling_profile.hpp"
#include "field_phenotyping/segmentation/stand_length.hpp"

namespace field_phenotyping {
namespace {

constexpr double kSpread = 0.06;

/// What stems of `typical` m show, of which the axes of a share run on.
std::vector<double> shownLengths(double typical, double excess, double share, int count,
                                 unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> length(typical, 0.05 * typical);
  std::exponential_distribution<double> beyond(1.0 / excess);
  std::bernoulli_distribution runs_on(share);
  std::vector<double> shown;
  for (int k = 0; k < count; ++k) {
    const double true_length = length(random);
    shown.push_back(runs_on(random) ? true_length + beyond(random) : true_length);
  }
  return shown;
}

TEST(StandLength, IsTheTypicalOne) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const StandLength stand = fitStandLength(shownLengths(1.7, 0.3, 0.15, 30, seed), kSpread).stand;
    ASSERT_TRUE(stand.known());
    EXPECT_NEAR(stand.typical, 1.7, 0.06) << "seed " << seed;
  }
}

TEST(StandLength, IsNotTheMedianWhereMostAxesRunOn) {
  // As seedlings: the youngest leaves rise as steeply as the stem.
  for (const unsigned seed : {4U, 5U, 6U}) {
    const StandLength stand =
        fitStandLength(shownLengths(0.16, 0.06, 0.8, 40, seed), kSpread).stand;
    EXPECT_NEAR(stand.typical, 0.16, 0.015) << "seed " << seed;
    EXPECT_GT(stand.excess_share, 0.5);
  }
}

TEST(StandLength, FewStemsSayNothing) {
  const StandLength stand = fitStandLength({1.7, 1.6, 1.8, 1.7}, kSpread).stand;
  EXPECT_FALSE(stand.known());
  EXPECT_DOUBLE_EQ(stand.logPrior(0.3), 0.0);
  EXPECT_DOUBLE_EQ(stand.likelyLength(2.3), 2.3);
  EXPECT_FALSE(fitStandLength({}, kSpread).stand.known());
  EXPECT_TRUE(standLengths({}, {}).empty());
}

TEST(StandLength, CutsOnlyWhatRanOn) {
  const StandLength stand = fitStandLength(shownLengths(1.7, 0.3, 0.15, 40, 7U), kSpread).stand;
  EXPECT_DOUBLE_EQ(stand.likelyLength(1.2), 1.2) << "a short plant is short";
  EXPECT_DOUBLE_EQ(stand.likelyLength(1.7), 1.7) << "what is usual stays";
  EXPECT_NEAR(stand.likelyLength(2.2), 1.75, 0.1) << "the axis ran on into a leaf or the tassel";
}

TEST(StandLength, PriorHasHeavyTails) {
  const StandLength stand = fitStandLength(shownLengths(1.7, 0.3, 0.15, 40, 8U), kSpread).stand;
  EXPECT_DOUBLE_EQ(stand.logPrior(stand.typical), 0.0);
  EXPECT_LT(stand.logPrior(stand.typical + stand.spread), 0.0);
  const double far = stand.logPrior(stand.typical - 5.0 * stand.spread);
  EXPECT_LT(far, -3.0);
  EXPECT_GT(far, -12.5) << "a normal one's";
}

TEST(StandLength, PlotsOfTwoVarietiesDifferInHeight) {
  // Their stems are the same share of their heights; the tall ones have not run on.
  std::vector<double> heights = shownLengths(1.6, 0.1, 0.0, 20, 10U);
  for (const double height : shownLengths(2.4, 0.1, 0.0, 20, 11U)) heights.push_back(height);
  std::mt19937 random(12U);
  std::normal_distribution<double> share(0.83, 0.015);
  std::vector<double> shown;
  for (const double height : heights) shown.push_back(share(random) * height);
  for (std::size_t k = 0; k < shown.size(); k += 8U) shown[k] = heights[k];  // to the tassel's tip
  const std::vector<StandLength> stands = standLengths(shown, heights);
  for (std::size_t k = 0; k < shown.size(); ++k) {
    EXPECT_NEAR(stands[k].typical, 0.83 * heights[k], 0.03 * heights[k]);
    if (k % 8U == 0U) {
      EXPECT_NEAR(stands[k].likelyLength(shown[k]), 0.83 * heights[k], 0.03 * heights[k]);
    } else {
      EXPECT_NEAR(stands[k].likelyLength(shown[k]), shown[k], 0.02 * heights[k]);
    }
  }
}

TEST(StandLength, HeightsThatSayNothingAreLeftOut) {
  // As where leaves of the neighbours reach over the stems.
  std::mt19937 random(13U);
  std::uniform_real_distribution<double> height(0.8, 1.6);
  const std::vector<double> shown = shownLengths(0.7, 0.1, 0.2, 30, 14U);
  std::vector<double> heights;
  for (std::size_t k = 0; k < shown.size(); ++k) heights.push_back(height(random));
  for (const StandLength& stand : standLengths(shown, heights)) {
    EXPECT_NEAR(stand.typical, 0.7, 0.03);
  }
}

/// A stand whose surfaces are sampled evenly up to 1.5 m, and from there less and less, up to 3 m.
SamplingProfile fallingAbove(double canopy = 0.0) {
  std::vector<float> heights;
  std::vector<LocalShape> shapes;
  for (int k = 0; k < 3000; ++k) {
    heights.push_back(0.001F * static_cast<float>(k));
    LocalShape shape;
    const float above = std::max(0.0F, heights.back() - 1.5F);
    shape.neighbors = 1U + static_cast<std::uint32_t>(200.0F * std::exp(-4.0F * above));
    shapes.push_back(shape);
  }
  return {heights, shapes, canopy};
}

TEST(StandLength, IsSeenAmongStemsThatStopShort) {
  // Two in five lose sight of their upper part.
  for (const unsigned seed : {15U, 16U, 17U, 18U}) {
    std::vector<double> shown = shownLengths(2.3, 0.2, 0.2, 60, seed);
    std::mt19937 random(seed);
    std::exponential_distribution<double> lost(1.0 / 0.35);
    std::bernoulli_distribution is_hidden(0.4);
    for (double& length : shown) {
      if (is_hidden(random)) length -= std::min(lost(random), 1.5);
    }
    const std::vector<double> heights(shown.size(), 2.8);
    EXPECT_NEAR(standLengths(shown, heights, fallingAbove()).front().typical, 2.3, 0.1)
        << "seed " << seed;
  }
}

TEST(StandLength, OneThatIsAtMostSoLongMayBeShorter) {
  const StandLength stand = fitStandLength(shownLengths(1.7, 0.3, 0.15, 40, 8U), kSpread).stand;
  EXPECT_DOUBLE_EQ(stand.logPriorWithin(2.5), 0.0);
  EXPECT_DOUBLE_EQ(stand.logPriorWithin(1.3), stand.logPrior(1.3));
}

TEST(SamplingProfile, FallsAboveTheHeightThatIsSampledBest) {
  const SamplingProfile profile = fallingAbove();
  EXPECT_DOUBLE_EQ(profile.at(0.3), 1.0);
  EXPECT_DOUBLE_EQ(profile.at(1.4), 1.0);
  for (const double above : {0.2, 0.4, 0.6, 0.8}) {
    EXPECT_NEAR(profile.at(1.5 + above) / std::exp(-4.0 * above), 1.0, 0.1) << above << " m above";
  }
  EXPECT_GT(profile.at(20.0), 0.0);
}

TEST(SamplingProfile, OfStemsFallsFromLowerDownTheTallerTheCanopy) {
  const SamplingProfile profile = fallingAbove(2.0);
  EXPECT_DOUBLE_EQ(profile.ofStems(1.0), 1.0);
  for (const double height : {1.4, 1.6, 1.8}) {
    EXPECT_DOUBLE_EQ(profile.ofStems(height), profile.at(height + 0.24)) << height << " m";
    EXPECT_DOUBLE_EQ(fallingAbove(1.0).ofStems(height), profile.at(height + 0.12)) << height;
  }
  EXPECT_DOUBLE_EQ(SamplingProfile().ofStems(1.0), 1.0);
}

TEST(SamplingProfile, LowPartsInTheShadeOfLeavesCountAsSampledBest) {
  std::vector<float> heights;
  std::vector<LocalShape> shapes(2000U);
  for (std::size_t k = 0; k < shapes.size(); ++k) {
    heights.push_back(0.001F * static_cast<float>(k));
    shapes[k].neighbors = k < 1000U ? 3U : 30U;
  }
  const SamplingProfile profile(heights, shapes, 2.0);
  EXPECT_DOUBLE_EQ(profile.at(0.5), 1.0);
  EXPECT_DOUBLE_EQ(profile.at(1.5), 1.0);
}

TEST(SamplingProfile, SaysFromWhereOnNothingLeadsFromPointToPoint) {
  // 7 neighbours of 200.
  EXPECT_NEAR(fallingAbove().sparseFrom(), 1.5 + std::log(200.0 / 7.0) / 4.0, 0.1);
  // A band that is sparse below the best one does not count, nor do stray points at the top.
  std::vector<float> heights;
  std::vector<LocalShape> shapes(1000U);
  for (std::size_t k = 0; k < shapes.size(); ++k) {
    heights.push_back(0.001F * static_cast<float>(k));
    shapes[k].neighbors = k < 500U ? 2U : 30U;
  }
  EXPECT_TRUE(std::isinf(SamplingProfile(heights, shapes, 1.0).sparseFrom()));
  heights.push_back(1.45F);
  shapes.emplace_back();
  EXPECT_NEAR(SamplingProfile(heights, shapes, 1.0).sparseFrom(), 1.0, 1e-9);
  // Nor does one tuft above that is seen better.
  for (std::size_t k = 0; k < 100U; ++k) {
    for (const auto& [height, neighbors] : {std::pair(1.05F, 3U), std::pair(1.15F, 12U)}) {
      heights.push_back(height);
      shapes.emplace_back();
      shapes.back().neighbors = neighbors;
    }
  }
  EXPECT_NEAR(SamplingProfile(heights, shapes, 1.0).sparseFrom(), 1.0, 1e-9);
}

TEST(SamplingProfile, IsOneWhereNothingTells) {
  EXPECT_DOUBLE_EQ(SamplingProfile().at(1.0), 1.0);
  EXPECT_TRUE(std::isinf(SamplingProfile().sparseFrom()));
  EXPECT_DOUBLE_EQ(SamplingProfile({}, {}, 0.05).at(1.0), 1.0);
  EXPECT_DOUBLE_EQ(SamplingProfile({0.01F, 0.02F}, {LocalShape(), LocalShape()}, 0.05).at(1.0), 1.0)
      << "soil";
}

TEST(StandLength, OrderDoesNotMatter) {
  std::vector<double> shown = shownLengths(0.7, 0.1, 0.5, 20, 9U);
  const StandLength one = fitStandLength(shown, kSpread).stand;
  const StandLength other = fitStandLength({shown.rbegin(), shown.rend()}, kSpread).stand;
  EXPECT_NEAR(one.typical, other.typical, 1e-9);
}

}  // namespace
}  // namespace field_phenotyping
