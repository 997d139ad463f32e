// Order statistics against std::nth_element.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <random>
#include <vector>

#include "field_phenotyping/common/order_statistic.hpp"

namespace field_phenotyping {
namespace {

template <class Value>
void expectLikeSorted(const std::vector<Value>& values) {
  std::vector<Value> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  for (std::size_t n = 0; n < values.size(); n += 1U + values.size() / 50U) {
    std::vector<Value> some = values;
    EXPECT_EQ(nthOf(some, n), sorted[n]) << n << " of " << values.size();
    std::sort(some.begin(), some.end());
    EXPECT_EQ(some, sorted);
  }
}

TEST(OrderStatistic, IsThatOfSortedValues) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  for (const std::size_t size : {1U, 2U, 3U, 4U, 7U, 30U, 100U, 3000U}) {
    for (const float steps : {0.5F, 3.0F, 1e6F}) {  // many are alike; hardly any
      std::vector<float> values(size);
      for (float& value : values) value = std::round(steps * normal(random)) / steps;
      expectLikeSorted(values);
      expectLikeSorted(std::vector<int>(values.begin(), values.end()));
    }
  }
}

TEST(OrderStatistic, WorksWhateverTheOrderWas) {
  std::vector<double> rising(2000);
  std::iota(rising.begin(), rising.end(), 0.0);
  expectLikeSorted(rising);
  expectLikeSorted(std::vector<double>(rising.rbegin(), rising.rend()));
  expectLikeSorted(std::vector<double>(2000, 3.0));
  std::vector<double> pipes = rising;  // least at both ends, and in the middle
  std::reverse(pipes.begin() + 500, pipes.begin() + 1000);
  std::reverse(pipes.begin() + 1000, pipes.end());
  expectLikeSorted(pipes);
}

TEST(OrderStatistic, EndsWithValuesThatAreNoNumbers) {
  const float none = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t n = 0; n < 5U; ++n) {
    std::vector<float> values{none, 1.0F, none, -1.0F, none};
    nthOf(values, n);
    std::vector<float> nothing(5, none);
    EXPECT_TRUE(std::isnan(nthOf(nothing, n)));
  }
}

}  // namespace
}  // namespace field_phenotyping
