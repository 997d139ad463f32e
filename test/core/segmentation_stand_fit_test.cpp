// Where the stems of a stand are once they are found: each with the help of the others.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/stand_fit.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

constexpr double kLength = 1.5;    // [m] of the stems
constexpr double kRadius = 0.008;  // [m]
constexpr double kNoise = 0.003;   // [m] of a point across a stem
constexpr double kSpacing = 0.25;  // [m] along the row
constexpr int kStems = 8;          // of the row
constexpr float kPlantHeight = 2.0F;

/// A row of bare stems, each with the midline that it was found with.
class StandFit : public ::testing::Test {
 protected:
  StandFit() : block_(testing::blockOf(testing::Scene(), testing::levelSoil())) {
    for (int k = 0; k < kStems; ++k) {
      addSurface(placeOf(k), kRadius, 2.0 * M_PI, 900);
      stems_.push_back(foundAs(placeOf(k), kRadius));
    }
  }

  static Eigen::Vector2d placeOf(int stem) { return {kSpacing * (stem - 0.5 * kStems), 0.0}; }

  /// Points of an upright surface, round +x.
  void addSurface(const Eigen::Vector2d& center, double radius, double arc, int count) {
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::normal_distribution<double> noise(0.0, kNoise);
    for (int k = 0; k < count; ++k) {
      const double angle = arc * (unit(random_) - 0.5);
      const double r = radius + noise(random_);
      block_.cloud.points.push_back(Eigen::Vector3d(center.x() + r * std::cos(angle),
                                                    center.y() + r * std::sin(angle),
                                                    kLength * unit(random_))
                                        .cast<float>());
    }
  }

  static GrownStem foundAs(const Eigen::Vector2d& center, double radius) {
    const Eigen::Vector3f base(static_cast<float>(center.x()), static_cast<float>(center.y()), 0);
    const auto r = static_cast<float>(radius);
    GrownStem stem;
    stem.midline.axis =
        StemAxis({{base, r}, {base + static_cast<float>(kLength) * Eigen::Vector3f::UnitZ(), r}});
    stem.midline.spread = static_cast<float>(kNoise);
    stem.midline.evidence = 100.0F;
    return stem;
  }

  std::vector<GrownStem> fitted() const {
    const SegmentationParameters parameters;
    const auto radius = static_cast<float>(parameters.seed_radius);
    const std::vector<Eigen::Vector3f>& points = block_.cloud.points;
    const NeighborGrid grid(points, radius);
    const std::vector<LocalShape> shapes = computeLocalShapes(points, grid, radius);
    return fitStand({points, shapes, grid}, StemSelection(block_, grid, parameters), kPlantHeight,
                    SamplingProfile(), stems_, parameters);
  }

  static void expectAt(const Eigen::Vector2d& center, double radius, const GrownStem& stem) {
    const StemAxis& axis = stem.midline.axis;
    for (const float height : {0.3F, 0.7F, 1.1F}) {
      const StemAxis::Projection at =
          axis.project({static_cast<float>(center.x()), static_cast<float>(center.y()), height});
      EXPECT_LT(at.distance, 0.002F) << "at " << height;
      EXPECT_NEAR(at.radius, radius, 0.25 * radius) << "at " << height;
    }
  }

  std::mt19937 random_{1U};
  Block block_;
  std::vector<GrownStem> stems_;
};

TEST_F(StandFit, BareStemsStayWhereTheyAre) {
  const std::vector<GrownStem> stems = fitted();
  ASSERT_EQ(stems.size(), stems_.size());
  for (int k = 0; k < kStems; ++k) {
    expectAt(placeOf(k), kRadius, stems[static_cast<std::size_t>(k)]);
  }
}

TEST_F(StandFit, FindsStemsWithinWhatWrapsThem) {
  // Leaves on one side of a stem that look like a part of a stem twice as thick, as which it was
  // found; of half of the stand.
  constexpr double kWrapped = 2.0 * kRadius;
  const Eigen::Vector2d off(kRadius, 0.0);
  for (int k = 0; k < kStems; k += 2) {
    const Eigen::Vector2d around = placeOf(k) + off;
    addSurface(around, kWrapped, 0.5 * M_PI, 300);
    stems_[static_cast<std::size_t>(k)] = foundAs(around, kWrapped);
  }
  const std::vector<GrownStem> stems = fitted();
  ASSERT_EQ(stems.size(), stems_.size());
  for (int k = 0; k < kStems; ++k) {
    expectAt(placeOf(k), kRadius, stems[static_cast<std::size_t>(k)]);
  }
}

TEST_F(StandFit, AThickStemStaysThick) {
  const Eigen::Vector2d center(0.0, 0.4);
  constexpr double kThick = 1.7 * kRadius;
  addSurface(center, kThick, 2.0 * M_PI, 1500);
  stems_.push_back(foundAs(center, kThick));
  const std::vector<GrownStem> stems = fitted();
  ASSERT_EQ(stems.size(), stems_.size());
  expectAt(center, kThick, stems.back());
}

}  // namespace
}  // namespace field_phenotyping
