// Points on a square metre: of a made plot in metres and in other units.
#include <gtest/gtest.h>

#include <limits>

#include "field_phenotyping/common/usual_density.hpp"

namespace field_phenotyping {
namespace {

/// 4 m x 3 m, a point every 5 cm, `factor` to the metre.
PointCloud plot(float factor) {
  PointCloud cloud;
  for (int x = 0; x < 80; ++x) {
    for (int y = 0; y < 60; ++y) {
      const Eigen::Vector3f middle(0.025F, 0.025F, 0.0F);
      cloud.points.push_back(
          factor *
          (0.05F * Eigen::Vector3f(static_cast<float>(x), static_cast<float>(y), 0.0F) + middle));
    }
  }
  return cloud;
}

TEST(UsualDensity, IsThatOfAnEvenPlot) {
  EXPECT_EQ(usualDensity(plot(1.0F)), 400U);
  EXPECT_EQ(usualDensity(plot(-1.0F)), 400U);
}

TEST(UsualDensity, TellsOtherUnits) {
  EXPECT_EQ(usualDensity(plot(1000.0F)), 1U);
  EXPECT_LE(usualDensity(plot(100.0F)), 1U);
}

TEST(UsualDensity, IsNotThatOfAFewStrayPoints) {
  PointCloud cloud = plot(1.0F);
  for (int k = 0; k < 400; ++k) cloud.points.emplace_back(1e4F * static_cast<float>(k), 0.0F, 0.0F);
  EXPECT_EQ(usualDensity(cloud), 400U);
}

TEST(UsualDensity, LeavesOutWhatIsNotFinite) {
  PointCloud cloud;
  EXPECT_EQ(usualDensity(cloud), 0U);
  cloud.points.assign(10, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
  EXPECT_EQ(usualDensity(cloud), 0U);
  cloud.points.emplace_back(3e38F, -3e38F, 0.0F);  // no square has such a number
  EXPECT_EQ(usualDensity(cloud), 1U);
}

}  // namespace
}  // namespace field_phenotyping
