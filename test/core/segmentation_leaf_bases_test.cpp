// Where leaves leave a stem, and which points near its surface are theirs.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "field_phenotyping/segmentation/leaf_bases.hpp"

namespace field_phenotyping {
namespace {

constexpr float kRadius = 0.010F;
constexpr float kLength = 1.2F;
constexpr float kNoise = 0.003F;
constexpr float kPi = 3.14159265F;

float apart(float a, float b) {
  return std::abs(std::remainder(a - b, 2.0F * kPi));
}

struct Leaf {
  float height;
  float azimuth;
  float slope;
};

/// A stem about the z axis and leaves, scanned with noise; leaves hide what is behind their feet.
class Plant {
 public:
  explicit Plant(unsigned seed) : random_(seed) {}

  void addStem(const std::vector<Leaf>& leaves, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      const float angle = kPi * (2.0F * unit_(random_) - 1.0F);
      const float height = kLength * unit_(random_);
      const bool hidden = std::any_of(leaves.begin(), leaves.end(), [&](const Leaf& leaf) {
        constexpr float kHides = 0.04F;
        return height > leaf.height && height < leaf.height + kHides &&
               apart(angle, leaf.azimuth) < 1.4F;
      });
      if (!hidden) add(kRadius, angle, height, false);
    }
    for (const Leaf& leaf : leaves) addLeaf(leaf);
  }

  /// A blade that crosses the field past the stem, `off` beyond its surface at the nearest.
  void addPassing(float height, float off, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      const float along = 0.2F * (unit_(random_) - 0.5F);
      const float up = 0.05F * (unit_(random_) - 0.5F);
      points.emplace_back(kRadius + off + noise_(random_), along, height + up);
      is_leaf.push_back(true);
    }
  }

  Midline midline() const {
    Midline midline;
    midline.axis = StemAxis({{{0.0F, 0.0F, 0.0F}, kRadius}, {{0.0F, 0.0F, kLength}, kRadius}});
    midline.spread = kNoise;
    return midline;
  }
  LeafBases bases() const {
    std::vector<std::uint32_t> members(points.size());
    std::iota(members.begin(), members.end(), 0U);
    return LeafBases(points, members, midline());
  }

  std::vector<Eigen::Vector3f> points;
  std::vector<bool> is_leaf;

 private:
  void add(float distance, float angle, float height, bool leaf) {
    const float at = distance + noise_(random_);
    points.emplace_back(at * std::cos(angle), at * std::sin(angle), height);
    is_leaf.push_back(leaf);
  }
  void addLeaf(const Leaf& leaf) {
    constexpr float kUp = 0.15F;
    for (int k = 0; k < 150; ++k) {
      const float up = kUp * unit_(random_);
      const float distance = kRadius + leaf.slope * up;
      const float half = std::asin(std::min((kRadius + 0.3F * up) / distance, 1.0F));
      add(distance, leaf.azimuth + half * (2.0F * unit_(random_) - 1.0F), leaf.height + up, true);
    }
  }

  std::mt19937 random_;
  std::uniform_real_distribution<float> unit_{0.0F, 1.0F};
  std::normal_distribution<float> noise_{0.0F, kNoise};
};

TEST(LeafBases, AreFoundWhereLeavesLeave) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (const float slope : {0.3F, 0.6F, 1.1F}) {
      const std::vector<Leaf> leaves{
          {0.3F, 0.5F, slope}, {0.55F, -2.7F, slope}, {0.8F, 3.1F, 1.2F * slope}};
      Plant plant(seed);
      plant.addStem(leaves, 600U);
      const std::vector<LeafBase> found = plant.bases().all();
      EXPECT_LE(found.size(), leaves.size() + 1U);
      EXPECT_TRUE(std::is_sorted(found.begin(), found.end(), [](const auto& a, const auto& b) {
        return a.arc_length < b.arc_length;
      }));
      for (const Leaf& leaf : leaves) {
        const bool seen = std::any_of(found.begin(), found.end(), [&](const LeafBase& base) {
          return std::abs(base.arc_length - leaf.height) < 0.012F &&
                 apart(base.azimuth, leaf.azimuth) < 0.35F &&
                 std::abs(std::log(base.slope / leaf.slope)) < 0.5F;
        });
        EXPECT_TRUE(seen) << "seed " << seed << ", leaf at " << leaf.height << ", slope " << slope;
      }
    }
  }
}

TEST(LeafBases, OfABareStemThereAreNone) {
  Plant plant(7U);
  plant.addStem({}, 600U);
  EXPECT_TRUE(plant.bases().all().empty());
  const LeafBases of_nothing({}, {}, plant.midline());
  EXPECT_TRUE(of_nothing.all().empty());
  EXPECT_EQ(of_nothing.leafShare({kRadius, 0.0F, 0.5F}, plant.midline().axis), 0.0F);
}

TEST(LeafBases, ALeafThatPassesIsNone) {
  for (const float off : {0.014F, 0.02F}) {
    Plant plant(8U);
    plant.addStem({}, 600U);
    plant.addPassing(0.6F, off, 150U);
    const std::vector<LeafBase> found = plant.bases().all();
    EXPECT_TRUE(found.empty()) << off;
  }
}

TEST(LeafBases, TellTheFootOfALeafFromTheStem) {
  const Leaf leaf{0.5F, 1.0F, 0.45F};
  Plant plant(9U);
  plant.addStem({leaf}, 600U);
  const LeafBases bases = plant.bases();
  const StemAxis axis = plant.midline().axis;
  const auto at = [&](float distance, float angle, float height) {
    return bases.leafShare({distance * std::cos(angle), distance * std::sin(angle), height}, axis);
  };
  EXPECT_GT(at(kRadius + 0.003F, leaf.azimuth, leaf.height + 0.010F), 0.8F);
  EXPECT_LT(at(kRadius, leaf.azimuth + kPi, leaf.height + 0.010F), 0.05F);
  EXPECT_LT(at(kRadius, leaf.azimuth, leaf.height - 0.02F), 0.05F);
  EXPECT_LT(at(kRadius, leaf.azimuth, leaf.height + 0.09F), 0.2F);
}

/// What the distance alone cannot do: with noise as large as the leaf is off the stem.
TEST(LeafBases, FewerErrorsThanByDistanceAlone) {
  std::size_t by_distance = 0U;
  std::size_t with_bases = 0U;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    std::vector<Leaf> leaves;
    for (int k = 0; k < 6; ++k) {
      const auto rank = static_cast<float>(k);
      leaves.push_back({0.2F + 0.15F * rank, 0.3F + kPi * rank, 0.4F});
    }
    Plant plant(seed);
    plant.addStem(leaves, 600U);
    const LeafBases bases = plant.bases();
    const StemAxis axis = plant.midline().axis;
    for (std::size_t i = 0; i < plant.points.size(); ++i) {
      const bool near = plant.points[i].head<2>().norm() < kRadius + 2.0F * kNoise;
      const bool stem = near && bases.leafShare(plant.points[i], axis) < 0.5F;
      by_distance += near == plant.is_leaf[i] ? 1U : 0U;
      with_bases += stem == plant.is_leaf[i] ? 1U : 0U;
    }
  }
  EXPECT_LT(static_cast<double>(with_bases), 0.65 * static_cast<double>(by_distance));
}

}  // namespace
}  // namespace field_phenotyping
