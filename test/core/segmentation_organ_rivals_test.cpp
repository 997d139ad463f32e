// Whose a piece of a leaf would be if not its plant's, and what that makes of the plant's top.

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <vector>

#include "field_phenotyping/segmentation/organ_rivals.hpp"

namespace field_phenotyping {
namespace {

TEST(Rivals, AreTheCheapestOtherPlants) {
  // Piece 0 is plant 0's, and nearly plant 2's; piece 1 only plant 1 gets at; nobody has piece 2.
  const std::vector<std::vector<Misfit>> costs = {
      {{0U, 3.0F}}, {{0U, 33.0F}, {1U, 1.0F}}, {{0U, 13.0F}, {2U, 5.0F}}};
  const std::vector<Rival> rivals = findRivals(costs, {0, 1, -1});
  ASSERT_EQ(rivals.size(), 3U);
  EXPECT_EQ(rivals[0].plant, 2);
  EXPECT_NEAR(rivals[0].chance, 0.5 * std::exp(-1.0), 1e-6);
  EXPECT_EQ(rivals[1].plant, -1);
  EXPECT_EQ(rivals[1].chance, 0.0F);
  EXPECT_EQ(rivals[2].chance, 0.0F);
}

TEST(Rivals, ThatAreNoDearerHaveEvenChances) {
  const std::vector<Rival> rivals = findRivals({{{0U, 4.0F}}, {{0U, 2.0F}}}, {0});
  EXPECT_EQ(rivals[0].plant, 1);
  EXPECT_FLOAT_EQ(rivals[0].chance, 0.5F);
}

TEST(Rivals, MakeTopsUncertainByWhatWouldBeLostOrWon) {
  // Plant 0 has a leaf up to 1.8 m that is as good for plant 1, and without it reaches 1.5 m. Plant
  // 1 reaches 1.6 m. Nobody doubts plant 2.
  OrganCells cells;
  LeafPieces pieces;
  pieces.cells.resize(1U);
  const auto add = [&](float z, std::int32_t plant, std::int32_t piece) {
    if (piece >= 0) pieces.cells[static_cast<std::size_t>(piece)].push_back(cells.size());
    cells.centers.emplace_back(0.0F, 0.0F, z);
    cells.owner.push_back(plant);
    pieces.of_cell.push_back(piece);
  };
  add(1.5F, 0, -1);
  add(1.7F, 0, 0);
  add(1.8F, 0, 0);
  add(1.6F, 1, -1);
  add(1.9F, 2, -1);
  add(2.5F, -1, -1);
  const StemAxis stem({{{0.0F, 0.0F, 0.0F}, 0.01F}, {{0.0F, 0.0F, 1.0F}, 0.01F}});
  const std::vector<LeafHost> hosts(3U, LeafHost{&stem, 1.0F, {}});
  const std::vector<float> stddevs = topStddevsOf(cells, pieces, {{1, 0.25F}}, hosts);
  ASSERT_EQ(stddevs.size(), 3U);
  EXPECT_NEAR(stddevs[0], 0.5F * 0.3F, 1e-5F);
  EXPECT_NEAR(stddevs[1], 0.5F * 0.2F, 1e-5F);
  EXPECT_EQ(stddevs[2], 0.0F);
  EXPECT_EQ(topStddevsOf(cells, pieces, {{1, 0.01F}}, hosts), std::vector<float>(3U, 0.0F));
}

TEST(Rivals, MakeWhatCarriesAStemOnUncertainAmongOthersLeaves) {
  // Plants 0 and 1 were followed up to 1.9 m. Above 1.5 m only leaves of plant 2 are about what is
  // plant 0's, and plant 1 stands free.
  OrganCells cells;
  LeafPieces pieces;
  pieces.cells.resize(1U);
  const auto add = [&](float x, float z, std::int32_t plant, std::int32_t piece) {
    if (piece >= 0) pieces.cells[static_cast<std::size_t>(piece)].push_back(cells.size());
    cells.centers.emplace_back(x, 0.0F, z);
    cells.owner.push_back(plant);
    pieces.of_cell.push_back(piece);
  };
  for (int k = 0; k < 20; ++k) {
    const float z = 0.95F + 0.05F * static_cast<float>(k);
    add(0.0F, z, 0, -1);
    add(1.0F, z, 1, -1);
    if (z > 1.57F) add(0.02F, z, 2, 0);
  }
  const StemAxis stem({{{0.0F, 0.0F, 0.0F}, 0.01F}, {{0.0F, 0.0F, 1.0F}, 0.01F}});
  const std::vector<LeafHost> hosts(3U, LeafHost{&stem, 1.9F, {}});
  const std::vector<float> stddevs = topStddevsOf(cells, pieces, {Rival()}, hosts);
  ASSERT_EQ(stddevs.size(), 3U);
  EXPECT_NEAR(stddevs[0], std::sqrt(0.5F) * 0.4F, 1e-5F);  // 1.5 m is sure
  EXPECT_EQ(stddevs[1], 0.0F);
  EXPECT_EQ(stddevs[2], 0.0F);
}

}  // namespace
}  // namespace field_phenotyping
