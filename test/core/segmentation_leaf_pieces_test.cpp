// Pieces of leaves, and how thick noise makes them.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/leaf_pieces.hpp"
#include "field_phenotyping/segmentation/organ_cells.hpp"

namespace field_phenotyping {
namespace {

constexpr float kWidth = 0.06F;  // [m]
constexpr int kLeaves = 6;

/// Leaves that arch away from one place, 15 cm apart, with noise across their surface.
Block leavesWith(float noise, float points_per_square_cm = 1.5F) {
  constexpr float kLength = 0.6F;  // [m]
  Block block;
  std::mt19937 random(3);
  std::normal_distribution<float> across(0.0F, noise);
  std::uniform_real_distribution<float> share(0.0F, 1.0F);
  const int count = static_cast<int>(1e4F * kLength * kWidth * points_per_square_cm);
  for (int leaf = 0; leaf < kLeaves; ++leaf) {
    const float azimuth = 0.7F * static_cast<float>(leaf);
    const Eigen::Vector3f outwards(std::cos(azimuth), std::sin(azimuth), 0.0F);
    const Eigen::Vector3f aside(-outwards.y(), outwards.x(), 0.0F);
    for (int k = 0; k < count; ++k) {
      const float turn = share(random);  // [rad] of an arc that is 60 cm long
      const Eigen::Vector3f surface =
          std::cos(turn) * outwards * kLength + std::sin(turn) * Eigen::Vector3f::UnitZ() * kLength;
      block.cloud.points.push_back(
          surface + kWidth * (share(random) - 0.5F) * aside +
          across(random) * surface.normalized() +
          Eigen::Vector3f(0.0F, 0.0F, 0.5F + 0.15F * static_cast<float>(leaf)));
    }
  }
  return block;
}

OrganCells cellsOf(const Block& block) {
  return gatherOrganCells(block, std::vector<std::int32_t>(block.cloud.size(), -1), {});
}

TEST(OrganCells, LeavesShowTheNoiseAcrossThem) {
  EXPECT_LT(cellsOf(leavesWith(0.002F)).noise, 0.003F);
  for (const float noise : {0.004F, 0.006F, 0.008F, 0.010F}) {
    EXPECT_NEAR(cellsOf(leavesWith(noise)).noise, noise, 0.3F * noise);
  }
}

TEST(LeafPieces, HoldNearlyAllOfALeafHoweverThickNoiseMakesIt) {
  for (const float noise : {0.001F, 0.003F, 0.006F, 0.008F}) {
    OrganCells cells = cellsOf(leavesWith(noise));
    const LeafPieces pieces = findLeafPieces(cells);
    std::size_t held = 0U;
    for (const std::vector<std::uint32_t>& members : pieces.cells) held += members.size();
    EXPECT_GT(static_cast<double>(held), 0.8 * cells.size()) << "noise " << noise;
  }
}

}  // namespace
}  // namespace field_phenotyping
