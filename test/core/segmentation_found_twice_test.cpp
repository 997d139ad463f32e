// Stems that rise from one place are one plant, unless they are seen side by side.

#include <gtest/gtest.h>

#include "field_phenotyping/segmentation/found_twice.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

constexpr float kLeastDistance = 0.06F;  // [m]

/// Straight from (x, y) on the soil, with its top at a height, shifted along x there.
GrownStem stemAt(float x, float y, float top, float hidden, std::size_t points,
                 float shift = 0.0F) {
  GrownStem stem;
  stem.midline.evidence = static_cast<float>(points);
  stem.midline.axis = StemAxis({{{x, y, 0.0F}, 0.01F}, {{x + shift, y, top}, 0.01F}});
  stem.midline.hidden = hidden;
  stem.points.resize(points);
  return stem;
}

/// Numbers of points of the stems that stay.
std::vector<std::size_t> sizesOf(std::vector<GrownStem> stems) {
  Block block;
  block.ground = testing::exactGround(testing::levelSoil());
  std::vector<std::size_t> sizes;
  for (const GrownStem& stem : withoutFoundTwice(block, std::move(stems), kLeastDistance)) {
    sizes.push_back(stem.points.size());
  }
  return sizes;
}

TEST(FoundTwice, APieceHighUpAStemIsNoPlantOfItsOwn) {
  // Seen above what is seen of the plant, with its foot where the plant's is.
  EXPECT_EQ(sizesOf({stemAt(0.0F, 0.0F, 0.5F, 0.0F, 40U), stemAt(0.04F, 0.0F, 1.0F, 0.6F, 12U)}),
            (std::vector<std::size_t>{40U}));
  EXPECT_EQ(sizesOf({stemAt(0.0F, 0.0F, 1.0F, 0.6F, 12U), stemAt(0.04F, 0.0F, 0.5F, 0.0F, 40U)}),
            (std::vector<std::size_t>{40U}));
  // All that is seen of it lies above where the stand says that stems end.
  EXPECT_EQ(sizesOf({stemAt(0.0F, 0.0F, 0.5F, 0.0F, 12U), stemAt(0.04F, 0.0F, 0.5F, 0.6F, 40U)}),
            (std::vector<std::size_t>{40U}));
}

TEST(FoundTwice, OneStemSeenTwiceOverTheSameHeight) {
  EXPECT_EQ(sizesOf({stemAt(0.0F, 0.0F, 1.0F, 0.2F, 20U), stemAt(0.003F, 0.0F, 0.9F, 0.3F, 30U)}),
            (std::vector<std::size_t>{30U}));
}

TEST(FoundTwice, NeighboursWhoseGuessedFeetMeetStayTwo) {
  // Stems 8 cm apart where they are seen: one foot or both were guessed.
  EXPECT_EQ(sizesOf({stemAt(0.0F, 0.0F, 1.2F, 0.4F, 50U, -0.04F),
                     stemAt(0.005F, 0.0F, 1.2F, 0.4F, 60U, 0.06F)}),
            (std::vector<std::size_t>{50U, 60U}));
}

TEST(FoundTwice, AFewUprightPointsOfALeafAreNoNeighbour) {
  EXPECT_EQ(
      sizesOf({stemAt(0.0F, 0.0F, 1.0F, 0.0F, 60U), stemAt(0.007F, 0.0F, 1.0F, 0.3F, 20U, 0.12F)}),
      (std::vector<std::size_t>{60U}));
}

TEST(FoundTwice, ARowSownAtTenCentimetres) {
  std::vector<GrownStem> row;
  std::vector<std::size_t> sizes;
  for (std::size_t k = 0; k < 10U; ++k) {
    const float along = 0.10F * static_cast<float>(k) + (k % 2U == 0U ? 0.012F : -0.012F);
    row.push_back(stemAt(along, 0.0F, 1.2F, k % 3U == 0U ? 0.5F : 0.0F, 20U + k));
    sizes.push_back(20U + k);
  }
  EXPECT_EQ(sizesOf(row), sizes);
}

TEST(FoundTwice, Nothing) {
  EXPECT_TRUE(sizesOf({}).empty());
}

}  // namespace
}  // namespace field_phenotyping
