// Which of the grown candidates are stems: straight stems of known points, and candidates that
// claim them, or leaves, rightly and wrongly.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::blockOf;
using testing::PlantTruth;
using testing::Scene;

constexpr double kLength = 1.5;

/// Stems, in a row if not said, and the candidates for them.
class Stand : public ::testing::Test {
 protected:
  struct Candidate {
    Midline midline;
    std::vector<std::uint32_t> points;
  };

  void build(const std::vector<double>& places) {
    for (const double x : places) addPlant({x, 0.0});
    makeBlock();
  }
  void addPlant(const Eigen::Vector2d& base, double lean = 0.0) {
    PlantTruth plant;
    plant.base = base;
    plant.stem_length = kLength;
    plant.lean = lean;
    scene_.addPlant(plant);
  }
  void makeBlock() { block_ = blockOf(scene_, testing::levelSoil(), &source_); }

  /// The points of the block that the given part of a plant truly has.
  std::vector<std::uint32_t> pointsOf(int plant, bool stem) const {
    std::vector<std::uint32_t> points;
    for (std::uint32_t i = 0; i < source_.size(); ++i) {
      const testing::PointTruth& truth = scene_.truth[source_[i]];
      if (truth.plant == plant && truth.stem == stem) points.push_back(i);
    }
    return points;
  }

  /// A candidate that stands at a place and claims those points.
  void add(const Eigen::Vector2d& place, double length, float evidence,
           std::vector<std::uint32_t> points, double lean = 0.0) {
    Candidate candidate;
    const Eigen::Vector3d base(place.x(), place.y(), 0.0);
    const Eigen::Vector3d top = base + length * Eigen::Vector3d(std::sin(lean), 0, std::cos(lean));
    candidate.midline.axis = StemAxis({{base.cast<float>(), 0.011F}, {top.cast<float>(), 0.011F}});
    candidate.midline.spread = 0.001F;
    candidate.midline.evidence = evidence;
    candidate.points = std::move(points);
    candidates_.push_back(std::move(candidate));
  }
  void addStem(int plant, float evidence = 150.0F) {
    const PlantTruth& truth = scene_.plants[static_cast<std::size_t>(plant)];
    add(truth.base, kLength, evidence, pointsOf(plant, true), truth.lean);
  }

  std::vector<std::size_t> select(const SegmentationParameters& parameters = {}) const {
    std::vector<StemCandidate> candidates;
    for (const Candidate& candidate : candidates_) {
      candidates.push_back({candidate.midline, candidate.points});
    }
    const NeighborGrid grid(block_.cloud.points, 0.02F);
    return StemSelection(block_, grid, parameters).stemsAmong(candidates);
  }

  Scene scene_{testing::levelSoil(), 1U};
  Block block_;
  std::vector<std::size_t> source_;
  std::vector<Candidate> candidates_;
};

TEST_F(Stand, AllStemsStay) {
  build({-0.6, -0.3, 0.0, 0.3, 0.6});
  for (int plant = 0; plant < 5; ++plant)
    addStem(plant, 100.0F + 20.0F * static_cast<float>(plant));
  EXPECT_EQ(select(), (std::vector<std::size_t>{0, 1, 2, 3, 4}));
}

TEST_F(Stand, NothingComesOfNothing) {
  build({0.0});
  EXPECT_TRUE(select().empty());
}

TEST_F(Stand, OfTwoForOneStemTheBetterStays) {
  build({-0.3, 0.0, 0.3});
  addStem(0, 90.0F);
  addStem(1);
  addStem(2);
  addStem(0, 120.0F);
  EXPECT_EQ(select(), (std::vector<std::size_t>{1, 2, 3}));
}

TEST_F(Stand, WhatHasNoPointsOnItsAxisIsNone) {
  build({-0.3, 0.0, 0.3});
  for (int plant = 0; plant < 3; ++plant) addStem(plant);
  add({0.15, 0.0}, kLength, 150.0F, pointsOf(1, false));  // a leaf's points, between two plants
  EXPECT_EQ(select(), (std::vector<std::size_t>{0, 1, 2}));
}

TEST_F(Stand, WhatIsLowForItsCanopyIsNone) {
  build({-0.3, 0.0, 0.3});
  addStem(1);
  addStem(2);
  std::vector<std::uint32_t> low = pointsOf(0, true);
  low.erase(std::remove_if(low.begin(), low.end(),
                           [&](std::uint32_t i) { return block_.cloud.points[i].z() > 0.12F; }),
            low.end());
  add({-0.3, 0.0}, 0.12, 20.0F, low);
  EXPECT_EQ(select(), (std::vector<std::size_t>{0, 1}));
}

TEST_F(Stand, CrowdedOnlyByItsEqual) {
  // 8 cm from a stem where the others stand 40 cm apart.
  build({-0.8, -0.4, 0.0, 0.08, 0.4, 0.8});
  for (int plant = 0; plant < 6; ++plant) addStem(plant);
  EXPECT_EQ(select().size(), 6U) << "as good as the others: a double plant";
  candidates_[3].midline.evidence = 75.0F;
  EXPECT_EQ(select(), (std::vector<std::size_t>{0, 1, 2, 4, 5}));
}

TEST_F(Stand, NearerThanThePlantsMayStand) {
  build({-0.3, 0.0, 0.05, 0.3});
  for (int plant = 0; plant < 4; ++plant) addStem(plant, plant == 1 ? 160.0F : 150.0F);
  SegmentationParameters parameters;
  parameters.min_plant_spacing = 0.06;
  EXPECT_EQ(select(parameters), (std::vector<std::size_t>{0, 1, 3}));
  parameters.min_plant_spacing = 0.03;
  EXPECT_EQ(select(parameters).size(), 4U);
}

TEST_F(Stand, WhatLeansUnlikeTheOthersMustBeBetterAlsoWhereThereAreNoRows) {
  for (const Eigen::Vector2d& place :
       {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(0.62, 0.31), Eigen::Vector2d(0.17, 0.74),
        Eigen::Vector2d(-0.55, 0.42), Eigen::Vector2d(-0.48, -0.37), Eigen::Vector2d(0.29, -0.58),
        Eigen::Vector2d(0.94, -0.21)}) {
    addPlant(place);
  }
  constexpr double kLean = 0.25;                             // [rad]
  addPlant({-0.5 * kLength * std::sin(kLean), 0.0}, kLean);  // it meets the first one half way up
  makeBlock();
  for (int plant = 0; plant < 8; ++plant) addStem(plant, plant == 0 ? 110.0F : 150.0F);
  candidates_[0].midline.hidden = 0.3F;
  EXPECT_EQ(select(), (std::vector<std::size_t>{0, 1, 2, 3, 4, 5, 6}));
  candidates_[0].midline.evidence = 30.0F;
  EXPECT_EQ(select(), (std::vector<std::size_t>{1, 2, 3, 4, 5, 6, 7}));
}

}  // namespace
}  // namespace field_phenotyping
