// Feet of stems that the canopy hides: made stems whose top is seen well and whose foot hardly.

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <random>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

constexpr float kLength = 1.5F;

StemAxis straight(const Eigen::Vector3f& base, const Eigen::Vector2f& slope) {
  return StemAxis(
      {{base, 0.011F}, {base + kLength * Eigen::Vector3f(slope.x(), slope.y(), 1.0F), 0.011F}});
}

StandLean uprightStand() {
  StandLean lean;
  lean.scatter = 0.03F;
  return lean;
}

/// A straight stem at the origin with that many points per metre above and below `seen_from`.
class Foot : public ::testing::Test {
 protected:
  void addStem(const Eigen::Vector2f& slope, float seen_from, int above, int below) {
    std::mt19937 random(5U);
    std::uniform_real_distribution<float> uniform;
    const auto add = [&](float from, float to, int count) {
      for (int k = 0; k < count; ++k) {
        const float z = from + (to - from) * uniform(random);
        const float turn = 2.0F * static_cast<float>(M_PI) * uniform(random);
        block_.cloud.points.emplace_back(z * slope.x() + 0.011F * std::cos(turn),
                                         z * slope.y() + 0.011F * std::sin(turn), z);
      }
    };
    add(0.0F, seen_from, static_cast<int>(static_cast<float>(below) * seen_from));
    add(seen_from, kLength, static_cast<int>(static_cast<float>(above) * (kLength - seen_from)));
  }

  /// Distance of the settled foot from the true one [m], when leaves have turned the midline about
  /// the height `pivot` by `turn`.
  float missBy(const Eigen::Vector2f& slope, const Eigen::Vector2f& turn, const StandLean& lean,
               float pivot = 1.2F) const {
    Midline midline;
    const Eigen::Vector2f turned = slope + turn;
    const Eigen::Vector2f base = pivot * (slope - turned);
    midline.axis = straight({base.x(), base.y(), 0.0F}, turned);
    midline.spread = 0.006F;
    const NeighborGrid grid(block_.cloud.points, 0.02F);
    const std::optional<SettledFoot> foot = settleFoot(block_, grid, midline, {lean, {}, {}});
    const StemAxis& settled = foot ? foot->axis : midline.axis;
    EXPECT_NEAR(settled.nodes().back().position.z(), kLength, 1e-4F);
    EXPECT_NEAR(settled.nodes().front().position.z(), 0.0F, 0.01F);
    return settled.nodes().front().position.head<2>().norm();
  }

  Block block_;
};

TEST_F(Foot, HiddenOneIsFoundAgain) {
  const Eigen::Vector2f slope(0.03F, -0.02F);
  addStem(slope, 1.0F, 300, 10);
  for (const Eigen::Vector2f& turn : {Eigen::Vector2f(0.05F, 0.0F), Eigen::Vector2f(0.0F, -0.05F),
                                      Eigen::Vector2f(0.03F, 0.03F)}) {
    EXPECT_LT(missBy(slope, turn, uprightStand()), 0.03F);
    EXPECT_GT(1.2F * turn.norm(), 0.045F) << "it was farther off";
  }
}

TEST_F(Foot, HiddenOneOfAPlantThatLeansFarMoreThanTheOthersIsFoundAgain) {
  const Eigen::Vector2f slope(0.12F, -0.11F);  // 5 standard deviations
  addStem(slope, 0.8F, 300, 10);
  for (const Eigen::Vector2f& turn : {Eigen::Vector2f(0.03F, 0.0F), Eigen::Vector2f(0.0F, -0.03F),
                                      Eigen::Vector2f(-0.02F, 0.02F)}) {
    EXPECT_LT(missBy(slope, turn, uprightStand()), 0.03F);
  }
}

TEST_F(Foot, HiddenOneBelowAStemThatIsSeenFarDownIsFoundAgain) {
  const Eigen::Vector2f slope(0.03F, -0.02F);
  addStem(slope, 0.4F, 300, 30);
  const float pivot = 0.8F;
  for (const Eigen::Vector2f& turn : {Eigen::Vector2f(0.05F, 0.0F), Eigen::Vector2f(0.0F, -0.05F),
                                      Eigen::Vector2f(-0.04F, -0.03F)}) {
    EXPECT_LT(missBy(slope, turn, uprightStand(), pivot), 0.02F);
    EXPECT_GT(pivot * turn.norm(), 0.035F) << "it was farther off";
  }
}

TEST_F(Foot, SeenOneStays) {
  const Eigen::Vector2f slope(0.15F, 0.1F);
  addStem(slope, 0.1F, 300, 300);
  EXPECT_LT(missBy(slope, Eigen::Vector2f::Zero(), uprightStand()), 1e-4F);
}

TEST_F(Foot, StaysWhereTheStandIsNotKnown) {
  const Eigen::Vector2f turn(0.08F, 0.0F);
  addStem(Eigen::Vector2f::Zero(), 1.0F, 300, 8);
  EXPECT_NEAR(missBy(Eigen::Vector2f::Zero(), turn, StandLean()), 1.2F * turn.norm(), 1e-4F);
}

TEST(Lean, OfAStand) {
  std::mt19937 random(3U);
  std::normal_distribution<float> off(0.0F, 0.08F);
  std::vector<StemAxis> stems;
  for (int k = 0; k < 5; ++k) stems.push_back(straight(Eigen::Vector3f::Zero(), {0.1F, 0.0F}));
  EXPECT_EQ(leanOf(stems).scatter, 0.0F) << "few tell nothing";
  stems.clear();
  for (int k = 0; k < 400; ++k) {
    const float x = off(random);
    const float y = off(random);
    stems.push_back(straight(Eigen::Vector3f::Zero(), {0.1F + x, -0.05F + y}));
  }
  const StandLean lean = leanOf(stems);
  EXPECT_NEAR(lean.slope.x(), 0.1F, 0.015F);
  EXPECT_NEAR(lean.slope.y(), -0.05F, 0.015F);
  EXPECT_NEAR(lean.scatter, 0.08F, 0.01F);
  EXPECT_NEAR(lean.deviation({0.1F + 0.24F, -0.05F}, 0.0F), 3.0F, 0.6F);
}

}  // namespace
}  // namespace field_phenotyping
