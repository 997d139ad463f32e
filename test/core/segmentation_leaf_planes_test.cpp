// The plane that a plant's leaves lie in, and whose a piece is by it.

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/leaf_planes.hpp"

namespace field_phenotyping {
namespace {

constexpr float kPi = 3.14159265F;
constexpr std::size_t kCells = 40U;  // of a leaf

/// Upright stems of 1.5 m, each with leaves to this side of it and to that in turn, a piece each.
class Stand {
 public:
  /// @param spread [rad] standard deviation of a leaf's azimuth from its plant's plane
  Stand(std::size_t plants, std::size_t leaves, float spread) {
    std::normal_distribution<float> off(0.0F, spread);
    std::uniform_real_distribution<float> any(-0.5F * kPi, 0.5F * kPi);
    for (std::size_t plant = 0; plant < plants; ++plant) {
      const auto x = static_cast<float>(plant);
      axes_.emplace_back(StemAxis({{{x, 0.0F, 0.0F}, 0.01F}, {{x, 0.0F, 1.5F}, 0.01F}}));
      planes.push_back(any(random_));
      for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
        addLeaf(plant, planes.back() + kPi * static_cast<float>(leaf % 2U) + off(random_),
                0.2F + 0.1F * static_cast<float>(leaf));
      }
    }
    for (const StemAxis& axis : axes_) hosts.push_back({&axis, 1.5F, {}});
  }

  std::uint32_t addLeaf(std::size_t plant, float azimuth, float height) {
    std::vector<std::uint32_t> members;
    for (std::size_t k = 0; k < kCells; ++k) {
      const float distance = 0.05F + 0.01F * static_cast<float>(k);
      members.push_back(cells.size());
      cells.centers.emplace_back(static_cast<float>(plant) + distance * std::cos(azimuth),
                                 distance * std::sin(azimuth), height + 0.2F * distance);
      cells.owner.push_back(static_cast<std::int32_t>(plant));
      cells.is_stem.push_back(0U);
      cells.shapes.emplace_back();
    }
    pieces.cells.push_back(std::move(members));
    return static_cast<std::uint32_t>(pieces.cells.size() - 1U);
  }

  /// A leaf that has no owner, and so shows no plane.
  std::uint32_t addStray(std::size_t plant, float azimuth) {
    const std::uint32_t piece = addLeaf(plant, azimuth, 1.2F);
    for (const std::uint32_t n : pieces.cells[piece]) cells.owner[n] = -1;
    return piece;
  }

  LeafPlanes learn() const { return LeafPlanes::learn(cells, pieces, hosts); }

  float misfit(const LeafPlanes& planes_of, std::uint32_t piece, std::size_t plant) const {
    PieceSamples samples;
    samples.take(cells, pieces.cells[piece], 3U);  // of 40, so that lanes are left over
    samples.lookFrom(*hosts[plant].axis);
    return planes_of.misfit(samples, piece, plant, hosts[plant]);
  }

  OrganCells cells;
  LeafPieces pieces;
  std::vector<LeafHost> hosts;
  std::vector<float> planes;  // azimuths [rad]

 private:
  std::mt19937 random_{5U};
  std::vector<StemAxis> axes_;
};

TEST(LeafPlanes, ClosenessIsThatOfTheLeaves) {
  // Of a normal distribution of azimuths the mean cosine of twice the angle is exp(-2 spread^2).
  for (const float spread : {0.2F, 0.3F, 0.5F}) {
    const LeafPlanes planes = Stand(200U, 10U, spread).learn();
    EXPECT_NEAR(planes.closeness()[0], std::exp(-2.0F * spread * spread), 0.03F) << spread;
    EXPECT_EQ(planes.closeness()[1], 0.0F) << "no leaf stands above the stems";
  }
}

TEST(LeafPlanes, TellNothingOfAStandWithoutThem) {
  const Stand stand(200U, 10U, 10.0F);
  const LeafPlanes planes = stand.learn();
  EXPECT_LT(planes.closeness()[0], 0.15F);
  EXPECT_NEAR(stand.misfit(planes, 0U, 0U), 0.0F, 0.15F);
}

TEST(LeafPlanes, TellNothingWhereTooFewLeavesShowThem) {
  const Stand stand(1U, 8U, 0.1F);
  const LeafPlanes planes = stand.learn();
  EXPECT_EQ(planes.closeness()[0], 0.0F);
  EXPECT_EQ(stand.misfit(planes, 0U, 0U), 0.0F);
}

TEST(LeafPlanes, PiecesInThePlaneAreLikelierAndThoseAcrossItRarer) {
  Stand stand(30U, 8U, 0.25F);
  const std::uint32_t in_plane = stand.addStray(3U, stand.planes[3] + kPi);
  const std::uint32_t across = stand.addStray(3U, stand.planes[3] + 0.5F * kPi);
  const std::uint32_t aslant = stand.addStray(3U, stand.planes[3] + 0.25F * kPi);
  const LeafPlanes planes = stand.learn();
  EXPECT_LT(stand.misfit(planes, in_plane, 3U), -1.0F);
  EXPECT_GT(stand.misfit(planes, across, 3U), 1.0F);
  EXPECT_GT(stand.misfit(planes, across, 3U), stand.misfit(planes, aslant, 3U));
}

TEST(LeafPlanes, MisfitsAreOfADistribution) {
  // A share of what would be there without a plane: its mean over all azimuths is 1.
  Stand stand(30U, 8U, 0.25F);
  constexpr int kAzimuths = 180;
  std::vector<std::uint32_t> around;
  for (int k = 0; k < kAzimuths; ++k) {
    around.push_back(stand.addStray(3U, kPi * static_cast<float>(k) / kAzimuths));
  }
  const LeafPlanes planes = stand.learn();
  double sum = 0.0;
  for (const std::uint32_t piece : around) {
    sum += std::exp(-static_cast<double>(stand.misfit(planes, piece, 3U)));
  }
  EXPECT_NEAR(sum / kAzimuths, 1.0, 1e-3);
}

TEST(LeafPlanes, APieceDoesNotBearItselfOut) {
  Stand stand(30U, 8U, 0.25F);
  // Of plant 0 one leaf is left.
  for (std::uint32_t piece = 0; piece < 8U; ++piece) {
    if (piece == 2U) continue;
    for (const std::uint32_t n : stand.pieces.cells[piece]) stand.cells.owner[n] = -1;
  }
  EXPECT_EQ(stand.misfit(stand.learn(), 2U, 0U), 0.0F);
}

}  // namespace
}  // namespace field_phenotyping
