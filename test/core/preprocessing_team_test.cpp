// Voxels, scores of soil planes and outliers: beside brute force, and the same whatever the team.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "emulated_team.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/preprocessing/outlier_filter.hpp"
#include "field_phenotyping/preprocessing/outlier_filter_team.hpp"
#include "field_phenotyping/preprocessing/soil_plane_team.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"

namespace field_phenotyping {
namespace {

TEST(Team, AddsUpTheValuesOfItsGroups) {
  for (const unsigned groups : {1U, 2U, 5U}) {
    std::vector<int> scratch(groups);
    std::vector<int> sums(groups * kLanes, 0);
    runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
      for (int round = 0; round < 20; ++round) {
        const int value = static_cast<int>(team.group()) + 1 + round;
        sums[team.rank()] += teamSum(team, value, scratch.data());
      }
    });
    const int g = static_cast<int>(groups);
    for (const int sum : sums) EXPECT_EQ(sum, 20 * g * (g + 1) / 2 + 190 * g);
  }
}

TEST(SoilPlane, ScoreIsThatOfBruteForceWhateverTheTeam) {
  constexpr float kTolerance = 0.05F;
  std::mt19937 random(4U);
  std::normal_distribution<float> normal(0.0F, 0.06F);
  std::uniform_real_distribution<float> place(-3.0F, 3.0F);
  for (const std::uint32_t count : {0U, 1U, 3U, 4U, 5U, 97U, 400U}) {
    std::vector<float> x(count + kLanes, NAN), y(x), z(x);  // nothing beyond the last counts
    for (std::uint32_t i = 0; i < count; ++i) {
      x[i] = place(random);
      y[i] = place(random);
      z[i] = 0.1F * x[i] - 0.2F * y[i] + 0.3F + normal(random);
    }
    const SoilCandidates points{x.data(), y.data(), z.data(), count};
    for (const SoilPlane& plane : {SoilPlane{0.1F, -0.2F, 0.3F}, SoilPlane{0.0F, 0.0F, 0.0F}}) {
      int expected = 0;
      for (std::uint32_t i = 0; i < count; ++i) {
        const float residual = z[i] - plane.heightAt(x[i], y[i]);
        if (std::abs(residual) <= kTolerance) ++expected;
        if (residual < -kTolerance) expected -= 3;
      }
      int scratch = 0;
      EXPECT_EQ(scorePlane(SerialTeam(), plane, points, kTolerance, &scratch), expected);
      for (const unsigned groups : {1U, 3U}) {
        std::vector<int> shared(groups);
        std::vector<int> scores(groups * kLanes);
        runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
          scores[team.rank()] = scorePlane(team, plane, points, kTolerance, shared.data());
        });
        for (const int score : scores) EXPECT_EQ(score, expected);
      }
    }
  }
}

TEST(OutlierFilter, KeepsWhatBruteForceKeepsWhateverTheTeam) {
  constexpr float kRadius = 0.05F;
  constexpr std::uint32_t kWanted = 4U;
  std::mt19937 random(8U);
  std::uniform_real_distribution<float> place(0.0F, 0.6F);
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 500; ++i) points.emplace_back(place(random), place(random), place(random));
  const NeighborGrid grid(points, kRadius);
  const GridView view = grid.view();
  std::vector<int> by_team(points.size(), -1);
  runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
    for (std::uint32_t k = team.group(); k < view.size; k += team.groups()) {
      const bool has = hasCompany(team.lanes(), view, k, kRadius, kWanted);
      if (team.lanes().first()) by_team[view.order[k]] = has ? 1 : 0;
    }
  });
  int kept = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    std::uint32_t near = 0U;
    for (const Eigen::Vector3f& p : points) {
      if ((p - points[i]).squaredNorm() <= kRadius * kRadius) ++near;
    }
    EXPECT_EQ(by_team[i], near >= kWanted ? 1 : 0) << i;
    kept += by_team[i];
  }
  EXPECT_GT(kept, 50);
  EXPECT_LT(kept, 450);
}

/// What the GPU does, step by step, with the routines that it does it with.
TEST(Voxels, OfPointsSortedByKeyAreThoseOfOneAfterTheOther) {
  constexpr float kVoxel = 0.05F;
  std::mt19937 random(21U);
  std::uniform_real_distribution<float> place(-0.3F, 0.3F);
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 3000; ++i) points.emplace_back(place(random), place(random), place(random));
  points.emplace_back(-0.05F, 0.0F, 0.1F);  // on borders
  points.emplace_back(0.0F, -0.0F, 0.05F);
  VoxelTile tile;
  VoxelTile at_once;
  for (const Eigen::Vector3f& p : points) tile.insert(p, kVoxel, false, 0U);
  at_once.insertAll(points, kVoxel, ComputeDevice());

  std::vector<Place> places;
  std::vector<std::uint64_t> keys;
  std::vector<std::uint32_t> order(points.size());
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    places.push_back(NeighborGrid::placeOf(points[i]));
    keys.push_back(voxelKeyOf(places.back(), kVoxel));
    EXPECT_EQ(keys.back(), voxelKey(points[i], kVoxel));
    order[i] = i;
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
  std::map<std::uint32_t, VoxelMean> by_opening;
  for (std::uint32_t begin = 0U, end = 0U; begin < order.size(); begin = end) {
    while (end < order.size() && keys[order[end]] == keys[order[begin]]) ++end;
    by_opening[order[begin]] = meanOfSorted(places.data(), order.data(), begin, end);
  }
  ASSERT_EQ(by_opening.size(), tile.size());
  ASSERT_EQ(at_once.size(), tile.size());
  std::size_t k = 0U;
  for (const auto& [first, voxel] : by_opening) {
    EXPECT_EQ(tile.centroid(k), Eigen::Vector3f(voxel.mean.x, voxel.mean.y, voxel.mean.z));
    EXPECT_EQ(at_once.centroid(k), tile.centroid(k));
    ++k;
  }
}

}  // namespace
}  // namespace field_phenotyping
