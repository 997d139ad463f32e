// Minimum cuts against every possible choice.

#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "field_phenotyping/common/minimum_cut.hpp"

namespace field_phenotyping {
namespace {

TEST(MinimumCut, ChoosesWhatCostsLessThanNothing) {
  MinimumCut cut(3U);
  cut.addCost(0U, 5);
  cut.addCost(1U, -5);
  cut.addCost(2U, 2);
  cut.addCost(2U, -3);
  EXPECT_EQ(cut.solve(), (std::vector<bool>{false, true, true}));
}

TEST(MinimumCut, PairsAreChosenTogether) {
  MinimumCut cut(2U);
  cut.addCost(0U, 3);
  cut.addCost(1U, -5);
  cut.addPairCost(0U, 1U, 4);
  EXPECT_EQ(cut.solve(), (std::vector<bool>{true, true}));
}

TEST(MinimumCut, LeastOfAllChoices) {
  std::mt19937 random(1U);
  std::uniform_int_distribution<std::int64_t> cost(-20, 20);
  std::uniform_int_distribution<std::int64_t> pair_cost(0, 12);
  for (int trial = 0; trial < 200; ++trial) {
    constexpr std::size_t kNodes = 8U;
    std::vector<std::int64_t> costs;
    std::vector<std::vector<std::int64_t>> pairs(kNodes, std::vector<std::int64_t>(kNodes, 0));
    MinimumCut cut(kNodes);
    for (std::size_t n = 0; n < kNodes; ++n) {
      costs.push_back(cost(random));
      cut.addCost(n, costs.back());
      for (std::size_t other = 0; other < kNodes; ++other) {
        if (other == n || pair_cost(random) % 2 != 0) continue;
        pairs[n][other] = pair_cost(random);
        cut.addPairCost(n, other, pairs[n][other]);
      }
    }
    const auto sumOf = [&](const auto& chosen) {
      std::int64_t sum = 0;
      for (std::size_t n = 0; n < kNodes; ++n) {
        sum += chosen(n) ? costs[n] : 0;
        for (std::size_t other = 0; other < kNodes; ++other) {
          sum += !chosen(n) && chosen(other) ? pairs[n][other] : 0;
        }
      }
      return sum;
    };
    std::int64_t least = std::numeric_limits<std::int64_t>::max();
    for (unsigned set = 0; set < 1U << kNodes; ++set) {
      least = std::min(least, sumOf([set](std::size_t n) { return (set >> n & 1U) != 0U; }));
    }
    const std::vector<bool> chosen = cut.solve();
    EXPECT_EQ(sumOf([&](std::size_t n) { return static_cast<bool>(chosen[n]); }), least);
  }
}

TEST(MinimumCut, NoNodes) {
  EXPECT_TRUE(MinimumCut(0U).solve().empty());
}

}  // namespace
}  // namespace field_phenotyping
