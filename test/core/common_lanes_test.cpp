// Functions of four values at once against those of one.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/lanes.hpp"

namespace field_phenotyping {
namespace {

TEST(Lanes, Exponentials) {
  for (float value = -86.9F; value < 86.9F; value += 0.037F) {
    const Floats exponentials = exponentialOf(Floats{value, 0.5F * value, -value, 0.0F});
    EXPECT_NEAR(exponentials[0] / std::exp(value), 1.0F, 1e-5F) << value;
    EXPECT_NEAR(exponentials[1] / std::exp(0.5F * value), 1.0F, 1e-5F) << value;
    EXPECT_NEAR(exponentials[2] / std::exp(-value), 1.0F, 1e-5F) << value;
    EXPECT_EQ(exponentials[3], 1.0F);
  }
}

TEST(Lanes, AreAsThreadsTheSame) {
  for (float value = -86.9F; value < 86.9F; value += 0.037F) {
    EXPECT_EQ(exponentialOf(allOf(value))[2], exponentialOfLane(value)) << value;
  }
}

TEST(Lanes, Arcsines) {
  for (float value = 0.0F; value <= 1.0F; value += 0.00037F) {
    const Floats arcsines = arcsineOf(Floats{value, 0.5F * value, 1.0F, 0.0F});
    EXPECT_NEAR(arcsines[0], std::asin(value), 1e-6F) << value;
    EXPECT_NEAR(arcsines[1], std::asin(0.5F * value), 1e-6F) << value;
    EXPECT_NEAR(arcsines[2], std::asin(1.0F), 1e-6F);
    EXPECT_NEAR(arcsines[3], 0.0F, 1e-6F);
  }
}

TEST(Lanes, Arctangents) {
  for (float angle = 0.0F; angle <= 1.5707F; angle += 0.00037F) {
    const float rise = std::sin(angle);
    const float run = std::cos(angle);
    const Floats angles =
        arctangentOf(Floats{rise, 7.0F * rise, 1.0F, 0.0F}, Floats{run, 7.0F * run, 0.0F, 0.0F});
    EXPECT_NEAR(angles[0], std::atan2(rise, run), 1e-6F) << angle;
    EXPECT_NEAR(angles[1], std::atan2(rise, run), 1e-6F) << angle;
    EXPECT_NEAR(angles[2], std::atan2(1.0F, 0.0F), 1e-6F);
    EXPECT_EQ(angles[3], 0.0F);
  }
}

TEST(Lanes, Logarithms) {
  for (float value = 1.0F; value < 1e12F; value *= 1.0037F) {
    const Floats logarithms = logarithmOf(Floats{value, value * value, 1.0F, 4.0F});
    EXPECT_NEAR(logarithms[0], std::log(value), 1e-6F * std::max(1.0F, std::log(value))) << value;
    EXPECT_NEAR(logarithms[1], std::log(value * value),
                1e-6F * std::max(1.0F, std::log(value * value)));
    EXPECT_EQ(logarithms[2], 0.0F);
    EXPECT_NEAR(logarithms[3], std::log(4.0F), 1e-6F);
  }
}

TEST(Lanes, ChooseAddAndAsk) {
  const Floats values{1.0F, -2.0F, 3.0F, 0.5F};
  EXPECT_EQ(total(values), 2.5F);
  EXPECT_EQ(total(largerOf(values, allOf(1.0F))), 6.0F);
  EXPECT_EQ(total(smallerOf(values, allOf(1.0F))), 0.5F);
  EXPECT_EQ(total(clampedTo(values, 0.0F, 2.0F)), 3.5F);
  EXPECT_EQ(total(magnitudeOf(values)), 6.5F);
  EXPECT_EQ(total(squareRootOf(Floats{1.0F, 4.0F, 9.0F, 0.25F})), 6.5F);
  EXPECT_TRUE(anyOf(values > 2.0F));
  EXPECT_FALSE(anyOf(values > 3.0F));
  EXPECT_EQ(bitsOf(values > 0.6F), 0b0101U);
  EXPECT_EQ(bitsOf(values < 0.0F), 0b0010U);
  EXPECT_EQ(bitsOf(values < 0.6F), 0b1010U);
  EXPECT_EQ(bitsOf(values > 3.0F), 0U);
}

}  // namespace
}  // namespace field_phenotyping
