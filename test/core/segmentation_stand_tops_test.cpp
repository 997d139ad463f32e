// Tops that were given to a neighbour, against stands of which the truth is known.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/stand_tops.hpp"

namespace field_phenotyping {
namespace {

/// A row of leaning stems of 1.2 m, 25 cm apart, each with a tassel above it and a leaf aside.
struct Row {
  std::vector<Eigen::Vector3f> points;
  std::vector<StemAxis> axes;
  PointOwners owners;
  std::mt19937 engine{1U};

  static constexpr float kTasselTop = 1.9F;
  static constexpr float kLeafTop = 1.4F;

  /// @param tip_off standard deviation of where the points of tassels stand off their line [m]
  explicit Row(std::size_t count, float tip_off = 0.03F) {
    for (std::size_t k = 0; k < count; ++k) {
      const float x = 0.25F * static_cast<float>(k);
      axes.emplace_back(std::vector<StemAxis::Node>{{{x, 0.0F, 0.0F}, 0.01F},
                                                    {{x + 0.03F, 0.02F, 0.6F}, 0.01F},
                                                    {{x + 0.06F, 0.04F, 1.2F}, 0.008F}});
      const auto plant = static_cast<std::int32_t>(k);
      for (float z = 0.01F; z < 1.2F; z += 0.02F) add(lineAt(k, z), plant, plant);
      std::normal_distribution<float> off(0.0F, tip_off);
      const Eigen::Vector3f aside(off(engine), off(engine), 0.0F);
      for (float z = 1.25F; z < kTasselTop; z += 0.005F) {
        const float share = (z - 1.2F) / (kTasselTop - 1.2F);
        add(lineAt(k, z) + share * aside, -1, plant);
      }
      for (float out = 0.05F; out < 0.5F; out += 0.01F) {
        const float below = 2.0F * (out - 0.25F) * (out - 0.25F);
        add(lineAt(k, 1.0F) + Eigen::Vector3f(0.0F, -out, kLeafTop - 1.0F - below), -1, plant);
      }
    }
  }
  void add(const Eigen::Vector3f& point, std::int32_t stem, std::int32_t plant) {
    points.push_back(point);
    owners.stem.push_back(stem);
    owners.plant.push_back(plant);
  }
  Eigen::Vector3f lineAt(std::size_t plant, float z) const { return axes[plant].pointAtHeight(z); }
  /// Gives what a plant has above its leaf to another.
  void giveTop(std::int32_t from, std::int32_t to) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (owners.plant[i] == from && points[i].z() > kLeafTop) owners.plant[i] = to;
    }
  }
  std::vector<float> doubts() const {
    SegmentedBlock block;
    for (std::size_t k = 0; k < axes.size(); ++k) {
      Plant plant;
      plant.axis = axes[k];
      plant.points.begin = static_cast<std::uint32_t>(block.cloud.size());
      for (std::size_t i = 0; i < points.size(); ++i) {
        if (owners.plant[i] == static_cast<std::int32_t>(k))
          block.cloud.points.push_back(points[i]);
      }
      plant.points.end = static_cast<std::uint32_t>(block.cloud.size());
      block.plants.push_back(plant);
    }
    return doubtTops(block);
  }
};

TEST(StandTops, NoneIsDoubtedWhereAllAreRight) {
  const Row row(12U);
  for (const float doubt : row.doubts()) EXPECT_EQ(doubt, 0.0F);
  Row given_back = row;
  const std::vector<float> given =
      giveTopsBack(given_back.points, given_back.axes, given_back.owners);
  EXPECT_EQ(given, std::vector<float>(12U, 0.0F));
  EXPECT_EQ(given_back.owners.plant, row.owners.plant);
}

TEST(StandTops, ATopGivenToANeighbourIsDoubtedOfBoth) {
  Row row(12U);
  row.giveTop(4, 5);
  for (std::size_t i = 0; i < row.points.size(); ++i) {  // of the neighbour a part is gone too
    if (row.owners.plant[i] == 5 && row.points[i].z() > 1.7F &&
        (row.points[i] - row.lineAt(5U, row.points[i].z())).norm() < 0.1F) {
      row.points[i].z() -= 0.3F;
    }
  }
  const std::vector<float> doubts = row.doubts();
  for (std::size_t plant = 0; plant < doubts.size(); ++plant) {
    if (plant == 4U || plant == 5U) {
      // The truth is within two standard deviations: 0.5 m, 0.2 m.
      EXPECT_GT(doubts[plant], plant == 4U ? 0.25F : 0.1F) << plant;
    } else {
      EXPECT_EQ(doubts[plant], 0.0F) << plant;
    }
  }
}

TEST(StandTops, AreGivenBack) {
  const Row right(12U);
  Row row = right;
  row.giveTop(4, 5);
  row.giveTop(8, 6);
  EXPECT_NE(row.owners.plant, right.owners.plant);
  const std::vector<float> doubts = giveTopsBack(row.points, row.axes, row.owners);
  EXPECT_EQ(row.owners.plant, right.owners.plant);
  // What was given may be wrong: the top is 0.5 m higher, within two standard deviations.
  ASSERT_EQ(doubts.size(), 12U);
  for (std::size_t plant = 0; plant < doubts.size(); ++plant) {
    if (plant == 4U || plant == 8U) {
      EXPECT_NEAR(doubts[plant], std::sqrt(0.5F) * (Row::kTasselTop - Row::kLeafTop), 0.02F);
    } else {
      EXPECT_LT(doubts[plant], 0.01F) << plant;
    }
  }
}

TEST(StandTops, PointsOfStemsStayTheirs) {
  Row row(12U);
  row.giveTop(4, 5);
  for (std::size_t i = 0; i < row.points.size(); ++i) {
    if (row.owners.plant[i] == 5) row.owners.stem[i] = 5;
  }
  const PointOwners before = row.owners;
  giveTopsBack(row.points, row.axes, row.owners);
  EXPECT_EQ(row.owners.plant, before.plant);
}

TEST(StandTops, WhereTipsStandFarOffTheirLinesChanceDisputesThem) {
  // Tips a quarter of a metre off: about half of all are nearer to another stem, with 0.5 m above
  // what is not disputed.
  const Row row(60U, 0.25F);
  std::vector<float> doubts = row.doubts();
  std::size_t disputed = 0U;
  for (const float doubt : doubts) {
    disputed += doubt > 0.0F ? 1U : 0U;
    EXPECT_LT(doubt, 0.25F);
  }
  EXPECT_GT(disputed, doubts.size() / 4U);
  Row given_back = row;
  giveTopsBack(given_back.points, given_back.axes, given_back.owners);
  EXPECT_EQ(given_back.owners.plant, row.owners.plant);
}

TEST(StandTops, OfOnePlantOrNone) {
  const Row one(1U);
  EXPECT_EQ(one.doubts(), std::vector<float>{0.0F});
  EXPECT_TRUE(doubtTops(SegmentedBlock()).empty());
  PointOwners none;
  EXPECT_TRUE(giveTopsBack({}, {}, none).empty());
  Row without_axis(3U);
  without_axis.axes[1] = StemAxis();
  giveTopsBack(without_axis.points, without_axis.axes, without_axis.owners);
  for (const float doubt : without_axis.doubts()) EXPECT_EQ(doubt, 0.0F);
}

}  // namespace
}  // namespace field_phenotyping
