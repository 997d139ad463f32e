// Where the leaves of low plants come together, against where they were made to.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/leaf_convergence.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::blockOf;
using testing::levelSoil;
using testing::Scene;

constexpr float kHeight = 0.4F;  // [m] of the plants
constexpr float kApart = 0.06F;  // [m]

/// Arched leaves without any stem.
class Leaves {
 public:
  explicit Leaves(unsigned seed) : scene_(levelSoil(), seed), random_(seed) {}

  void add(const Eigen::Vector2d& from, double azimuth, int points = 60) {
    constexpr double kBegins = 0.06;  // [m] above the soil
    constexpr double kLength = 0.25;  // [m] horizontally
    std::normal_distribution<double> noise(0.0, 0.003);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    for (int k = 0; k < points; ++k) {
      const double out = kLength * unit(random_);
      const double across = 0.02 * (unit(random_) - 0.5);
      const double rise = 1.6 * out - 3.0 * out * out;
      const Eigen::Vector2d along(std::cos(azimuth), std::sin(azimuth));
      const Eigen::Vector2d at =
          from + out * along + across * Eigen::Vector2d(-along.y(), along.x());
      scene_.cloud.points.emplace_back(static_cast<float>(at.x() + noise(random_)),
                                       static_cast<float>(at.y() + noise(random_)),
                                       static_cast<float>(kBegins + rise + noise(random_)));
      scene_.truth.push_back({-1, false, false});
    }
  }

  std::vector<LeafConvergence> converge() const {
    const Block block = blockOf(scene_, levelSoil());
    constexpr float kRadius = 0.04F;
    const NeighborGrid grid(block.cloud.points, kRadius);
    return findLeafConvergences(block, computeLocalShapes(block.cloud.points, grid, kRadius),
                                kHeight, kApart);
  }

 private:
  Scene scene_;
  std::mt19937 random_;
};

double missed(const LeafConvergence& found, const Eigen::Vector2d& truth) {
  return (found.place.cast<double>() - truth).norm();
}

TEST(LeafConvergence, LeavesOfOnePlantLeadToItsPlace) {
  double squares = 0.0;
  constexpr unsigned kPlants = 20U;
  for (unsigned seed = 1U; seed <= kPlants; ++seed) {
    const double azimuth = 0.3 * seed;
    const Eigen::Vector2d place(0.013 * seed, -0.021 * seed);
    Leaves leaves(seed);
    for (int k = 0; k < 4; ++k) leaves.add(place, azimuth + M_PI * k + 0.2 * (k / 2));
    const std::vector<LeafConvergence> found = leaves.converge();
    ASSERT_FALSE(found.empty());
    squares += std::pow(missed(found.front(), place), 2.0);
    for (std::size_t k = 1; k < found.size(); ++k) {
      EXPECT_LT(found[k].votes, 0.3F * found.front().votes) << seed;
    }
  }
  EXPECT_LT(std::sqrt(squares / kPlants), 0.01);
}

TEST(LeafConvergence, FewPointsAreEnough) {
  double squares = 0.0;
  constexpr unsigned kFields = 20U;
  for (unsigned seed = 1U; seed <= kFields; ++seed) {
    Leaves leaves(seed);
    for (int k = 0; k < 4; ++k) leaves.add({0.0, 0.0}, 0.3 + M_PI * k, 20);
    const std::vector<LeafConvergence> found = leaves.converge();
    ASSERT_FALSE(found.empty());
    squares += std::pow(missed(found.front(), {0.0, 0.0}), 2.0);
  }
  EXPECT_LT(std::sqrt(squares / kFields), 0.02);
}

TEST(LeafConvergence, NeighborsInOneRowHaveAPlaceEach) {
  Leaves leaves(1U);
  for (const double x : {-0.3, -0.15, 0.0, 0.15, 0.3}) {
    for (int k = 0; k < 4; ++k) leaves.add({x, 0.0}, 1.2 + M_PI * k + 3.0 * x);
  }
  const std::vector<LeafConvergence> found = leaves.converge();
  ASSERT_GE(found.size(), 5U);
  for (std::size_t k = 0; k < 5U; ++k) {
    const double x = found[k].place.x();
    EXPECT_LT(missed(found[k], {0.15 * std::round(x / 0.15), 0.0}), 0.015);
    for (std::size_t other = 0; other < k; ++other) {
      EXPECT_GT((found[k].place - found[other].place).norm(), 0.1F);
    }
  }
  for (std::size_t k = 5; k < found.size(); ++k) {
    EXPECT_LT(found[k].votes, 0.5F * found[4].votes);
  }
}

TEST(LeafConvergence, OneLeafAloneLeadsNowhere) {
  Leaves one(1U);
  one.add({0.0, 0.0}, 0.3);
  Leaves two(1U);
  for (int k = 0; k < 2; ++k) two.add({0.0, 0.0}, 0.3 + M_PI * k);
  const std::vector<LeafConvergence> of_two = two.converge();
  ASSERT_FALSE(of_two.empty());
  for (const LeafConvergence& found : one.converge()) {
    EXPECT_LT(found.votes, 0.35F * of_two.front().votes);
  }
}

TEST(LeafConvergence, NothingComesOfNothing) {
  EXPECT_TRUE(Leaves(1U).converge().empty());
}

}  // namespace
}  // namespace field_phenotyping
