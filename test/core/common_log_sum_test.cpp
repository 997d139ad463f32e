// Sums of logarithms by products against sums of logarithms.

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "field_phenotyping/common/log_sum.hpp"

namespace field_phenotyping {
namespace {

TEST(LogSum, OfFactorsWhoseProductNoDoubleHolds) {
  EXPECT_EQ(LogSum().value(), 0.0);
  std::mt19937 random(3U);
  std::uniform_real_distribution<double> exponent(-90.0, 60.0);
  LogSum sum;
  double expected = 0.0;
  for (int i = 0; i < 1000; ++i) {
    const double factor = std::pow(10.0, exponent(random));
    sum.add(factor);
    expected += std::log(factor);
  }
  EXPECT_NEAR(sum.value(), expected, 1e-9 * std::abs(expected));
}

}  // namespace
}  // namespace field_phenotyping
