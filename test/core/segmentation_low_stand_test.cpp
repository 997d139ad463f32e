// Seedlings whose stems are shorter than the pieces that tall plants are looked for by.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "field_phenotyping/segmentation/low_stand.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::basesOf;
using testing::blockOf;
using testing::levelSoil;
using testing::matchBases;
using testing::PlantTruth;
using testing::Scene;

/// Seedlings 18 cm tall: 8 cm of stem, above it two pairs of leaves that open slowly.
class Seedlings {
 public:
  explicit Seedlings(unsigned seed, int stem_points_per_metre = 300)
      : scene(levelSoil(), seed, 0.002),
        stem_points_per_metre_(stem_points_per_metre),
        random_(seed) {}

  void add(double x, double y) {
    PlantTruth plant;
    plant.base = {x, y};
    plant.stem_length = kStem;
    plant.radius = 0.003;
    plant.leaves = 0;
    plant.stem_points_per_metre = stem_points_per_metre_;
    const auto index = static_cast<int>(scene.plants.size());
    scene.addPlant(plant);
    addLeaves(index, plant.base);
  }

  /// What looks like a plant's leaves, but stands on no stem. @param plant whose; -1: nobody's
  void addLeaves(int plant, const Eigen::Vector2d& base) {
    const double azimuth = M_PI * unit_(random_);
    for (const double slope : {0.25, 0.8}) {
      for (const double side : {-1.0, 1.0}) addLeaf(plant, base, azimuth, side * slope);
    }
  }

  void addRow(double y) {
    std::normal_distribution<double> stray(0.0, 0.01);
    for (double x = -0.9; x < 0.91; x += 0.2) add(x + stray(random_), y + stray(random_));
  }

  Scene scene;

 private:
  static constexpr double kStem = 0.08;

  void addLeaf(int plant, const Eigen::Vector2d& base, double azimuth, double slope) {
    constexpr int kPoints = 20;
    constexpr double kRise = 0.10;
    std::normal_distribution<double> noise(0.0, 0.003);
    for (int k = 0; k < kPoints; ++k) {
      const double rise = kRise * unit_(random_);
      scene.cloud.points.emplace_back(
          static_cast<float>(base.x() + slope * rise * std::cos(azimuth) + noise(random_)),
          static_cast<float>(base.y() + slope * rise * std::sin(azimuth) + noise(random_)),
          static_cast<float>(kStem + rise));
      scene.truth.push_back({plant, false, false});
    }
  }

  int stem_points_per_metre_;
  std::mt19937 random_;
  std::uniform_real_distribution<double> unit_{0.0, 1.0};
};

/// Plants that were found where one stands, and elsewhere.
struct Found {
  std::size_t right = 0U;
  std::size_t wrong = 0U;
};

Found find(const Scene& scene) {
  const SegmentedBlock out = segmentBlock(blockOf(scene, levelSoil()), {});
  Found found;
  found.right = matchBases(basesOf(scene), basesOf(out)).pairs.size();
  found.wrong = out.plants.size() - found.right;
  return found;
}

TEST(LowStand, PiecesShrinkWithThePlants) {
  SegmentationParameters asked;
  asked.seed_min_length = 0.2;
  for (const float height : {0.8F, 0.81F, 2.5F}) {
    const SegmentationParameters tall = adaptToHeight(height, asked);
    EXPECT_EQ(tall.seed_slab, asked.seed_slab) << height;
    EXPECT_EQ(tall.seed_min_length, asked.seed_min_length) << height;
  }
  const SegmentationParameters low = adaptToHeight(0.4F, asked);
  EXPECT_NEAR(low.seed_slab, 0.5 * asked.seed_slab, 1e-6);
  EXPECT_NEAR(low.seed_min_length, 0.5 * asked.seed_min_length, 1e-6);
  EXPECT_NEAR(low.seed_min_height, 0.012, 1e-6);
  EXPECT_NEAR(adaptToHeight(1.0F, asked).seed_min_height, 0.03, 1e-6);
  EXPECT_EQ(adaptToHeight(2.5F, asked).seed_min_height, asked.seed_min_height);
  EXPECT_NEAR(adaptToHeight(0.01F, asked).seed_slab, adaptToHeight(0.15F, asked).seed_slab, 1e-6)
      << "not ever shorter where there is but soil";
}

/// At least so many percent of the plants, and 95 percent of what was found are plants.
void expectMostFound(const Found& found, std::size_t plants, std::size_t percent) {
  std::printf("%zu of %zu, %zu wrong\n", found.right, plants, found.wrong);
  EXPECT_GE(100U * found.right, percent * plants);
  EXPECT_GE(100U * found.right, 95U * (found.right + found.wrong));
}

/// Looks for the plants of three rows in four fields, at least so many percent of which are found.
/// @param distance between the rows [m]
/// @param addWeeds to a scene
template <class AddWeeds>
void expectFoundInRows(double distance, const AddWeeds& addWeeds, std::size_t percent) {
  std::size_t plants = 0U;
  Found found;
  for (unsigned seed = 1U; seed <= 4U; ++seed) {
    Seedlings field(seed);
    for (const double y : {-distance, 0.0, distance}) field.addRow(y);
    plants += field.scene.plants.size();
    addWeeds(field.scene);
    const Found here = find(field.scene);
    found.right += here.right;
    found.wrong += here.wrong;
  }
  expectMostFound(found, plants, percent);
}

TEST(LowStand, SeedlingsAreFoundInTheirRows) {
  expectFoundInRows(
      0.5, [](Scene&) {}, 95U);
}

TEST(LowStand, WeedsBetweenTheRowsAreNoPlants) {
  const auto addWeeds = [](Scene& scene) {
    for (int k = 0; k < 6; ++k) {
      scene.addWeed({-0.9 + 0.31 * k, k % 2 == 0 ? 0.28 : -0.33}, 0.10 + 0.01 * k);
    }
  };
  expectFoundInRows(0.6, addWeeds, 90U);
}

// Seen so sparsely that hardly a point is on a stem: the leaves show where it must be.
TEST(LowStand, LeavesShowStemsThatAreNotSeen) {
  Found found;
  std::size_t plants = 0U;
  for (unsigned seed = 1U; seed <= 4U; ++seed) {
    constexpr int kStemPoints = 25;  // a metre: two of a plant
    Seedlings field(seed, kStemPoints);
    for (const double y : {-0.5, 0.0, 0.5}) field.addRow(y);
    plants += field.scene.plants.size();
    const Found here = find(field.scene);
    found.right += here.right;
    found.wrong += here.wrong;
  }
  expectMostFound(found, plants, 95U);
}

// Leaves of neighbours cross between plants, as if they came from a stem there. Stems that are seen
// would show it.
TEST(LowStand, LeavesShowNoStemsWhereTheOthersAreSeen) {
  Found found;
  std::size_t plants = 0U;
  for (unsigned seed = 1U; seed <= 4U; ++seed) {
    constexpr int kStemPoints = 1000;  // a metre: 80 of a plant
    Seedlings field(seed, kStemPoints);
    for (const double y : {-0.5, 0.0, 0.5}) {
      field.addRow(y);
      for (double x = -0.8; x < 0.81; x += 0.4) {
        for (int plant = 0; plant < 4; ++plant) field.addLeaves(-1, {x, y});
      }
    }
    plants += field.scene.plants.size();
    const Found here = find(field.scene);
    found.right += here.right;
    found.wrong += here.wrong;
  }
  expectMostFound(found, plants, 95U);
}

// As low as weeds, and in no rows: nothing tells them from weeds.
TEST(LowStand, WithoutRowsShortPiecesAreNoPlants) {
  Found found;
  for (unsigned seed = 1U; seed <= 4U; ++seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> place(-0.9, 0.9);
    Scene scene(levelSoil(), seed);
    for (int k = 0; k < 30; ++k) scene.addWeed({place(random), place(random)}, 0.05 + 0.005 * k);
    found.wrong += find(scene).wrong;
  }
  std::printf("%zu of 120 weeds\n", found.wrong);
  EXPECT_EQ(found.wrong, 0U);
}

}  // namespace
}  // namespace field_phenotyping
