#include "field_phenotyping/segmentation/isolated_points.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/robust_spread.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"

namespace field_phenotyping {
namespace {

constexpr float kPi = 3.14159265F;

/// A stem as its points show it.
struct SeenStem {
  RobustSpread off;             // of its points, outside the axis' radius [m]
  std::vector<float> sorted_s;  // lengths along the axis [m]

  /// Its points to a metre of the axis, about length `s`, one being looked at.
  float densityAt(float s) const {
    constexpr float kSpan = 0.15F;  // [m] to either side
    const auto low = std::lower_bound(sorted_s.begin(), sorted_s.end(), s - kSpan);
    const auto high = std::upper_bound(low, sorted_s.end(), s + kSpan);
    return (1.0F + static_cast<float>(high - low)) / (2.0F * kSpan);
  }
};

std::vector<SeenStem> seenStems(const Block& block, const std::vector<StemAxis>& axes,
                                const std::vector<std::int32_t>& stem_owner) {
  constexpr float kLeastNoise = 0.0015F;  // [m]
  std::vector<SeenStem> stems(axes.size());
  std::vector<std::vector<float>> off(axes.size());
  for (std::size_t i = 0; i < stem_owner.size(); ++i) {
    if (stem_owner[i] < 0) continue;
    const auto stem = static_cast<std::size_t>(stem_owner[i]);
    const StemAxis::Projection at = axes[stem].project(block.cloud.points[i]);
    stems[stem].sorted_s.push_back(at.arc_length);
    off[stem].push_back(at.distance - at.radius);
  }
  for (std::size_t s = 0; s < stems.size(); ++s) {
    if (off[s].empty()) continue;
    std::sort(stems[s].sorted_s.begin(), stems[s].sorted_s.end());
    stems[s].off = robustSpreadOf(off[s], kLeastNoise);
  }
  return stems;
}

/// Gives isolated points to the stems that explain them.
void giveToStems(const Block& block, const NeighborGrid& grid, const NeighborGrid& isolated,
                 const std::vector<StemAxis>& axes, const PointOwners& known, PointOwners& owners) {
  constexpr std::size_t kFew = 6U;     // points: less say nothing of a stem
  constexpr float kWidth = 3.0F;       // standard deviations from the surface
  constexpr float kAround = 0.10F;     // [m] where other things are counted
  constexpr float kAtLeastOne = 1.0F;  // more of them than are seen
  constexpr float kVolume = 4.0F / 3.0F * kPi * kAround * kAround * kAround;
  const std::vector<SeenStem> stems = seenStems(block, axes, known.stem);
  std::vector<float> best(block.isolated.size(), 0.0F);
  for (std::size_t s = 0; s < axes.size(); ++s) {
    const SeenStem& stem = stems[s];
    if (stem.sorted_s.size() < kFew) continue;
    const auto owner = static_cast<std::int32_t>(s);
    const float width = stem.off.middle + kWidth * stem.off.stddev;
    StemAxis::Node low{baseOf(block, axes[s]), axes[s].radiusAt(0.0F)};
    for (const StemAxis::Node& high : axes[s].nodes()) {
      const StemAxis::Node below = low;
      low = high;
      if (below.position == high.position) continue;
      const float reach = std::max(below.radius, high.radius) + width;
      isolated.forEachWithinOfLine(below.position, high.position, reach, [&](std::uint32_t i) {
        const Eigen::Vector3f& p = block.isolated.points[i];
        const StemAxis::Projection at = axes[s].project(p);
        if (at.arc_length > axes[s].length()) return;
        const float surface = at.radius + stem.off.middle;
        // Points a volume: [1/m^3].
        const float of_stem = stem.densityAt(at.arc_length) *
                              normalDensity(at.distance - surface, stem.off.stddev) /
                              (2.0F * kPi * std::max(at.distance, surface));
        if (!(of_stem > best[i])) return;
        float others = kAtLeastOne;
        grid.forEachWithin(p, kAround, [&](std::uint32_t k, float) {
          if (known.stem[k] != owner) others += 1.0F;
        });
        if (of_stem < others / kVolume) return;
        best[i] = of_stem;
        owners.stem[i] = owners.plant[i] = owner;
      });
    }
  }
}

/// How far from plants isolated points are still theirs [m], 0: not at all. Dust is as dense near
/// plants as it is farther off, where nothing else is.
float reachOfPlants(const Block& block, const NeighborGrid& grid) {
  constexpr float kFar = 0.20F;      // [m]
  constexpr float kMostDust = 0.2F;  // share of what is given
  constexpr std::size_t kSamples = 500U;
  struct Reach {
    float distance;  // [m]
    float volume;  // where isolated points may lie nearer, to that from the farthest reach to kFar
    float count;
  };
  std::array<Reach, 3> reaches = {{{0.06F, 0.2F, 0.0F}, {0.08F, 0.5F, 0.0F}, {0.10F, 0.8F, 0.0F}}};
  float far = 0.0F;
  const std::size_t step = std::max<std::size_t>(1U, block.isolated.size() / kSamples);
  for (std::size_t i = 0; i < block.isolated.size(); i += step) {
    const Eigen::Vector3f& p = block.isolated.points[i];
    for (Reach& reach : reaches) reach.count += grid.hasWithin(p, reach.distance, 1U) ? 1.0F : 0.0F;
    if (grid.hasWithin(p, kFar, 1U)) far += 1.0F;
  }
  far -= reaches.back().count;
  float farthest = 0.0F;
  for (const Reach& reach : reaches) {
    if (reach.volume * far < kMostDust * reach.count) farthest = reach.distance;
  }
  return farthest;
}

/// Gives the rest of them to the plants that they are next to.
void giveToPlants(const Block& block, const NeighborGrid& grid, const NeighborGrid& isolated,
                  float reach, const PointOwners& known, PointOwners& owners) {
  const std::vector<Eigen::Vector3f>& points = block.isolated.points;
  std::vector<std::uint8_t> beside(points.size(), 0U);  // points of the block's cloud
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (owners.plant[i] >= 0) continue;
    float nearest = std::numeric_limits<float>::infinity();
    grid.forEachWithin(points[i], reach, [&](std::uint32_t k, float squared) {
      if (!(squared < nearest)) return;
      nearest = squared;
      beside[i] = 1U;
      owners.plant[i] = known.stem[k] >= 0 ? known.stem[k] : known.plant[k];
    });
  }
  // Those of a sparse tip that lie next to such a point only.
  constexpr int kMostInARow = 4;
  for (int round = 0; round < kMostInARow; ++round) {
    const std::vector<std::int32_t> before = owners.plant;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (before[i] >= 0 || beside[i] != 0U) continue;
      float nearest = std::numeric_limits<float>::infinity();
      isolated.forEachWithin(points[i], reach, [&](std::uint32_t k, float squared) {
        if (before[k] < 0 || !(squared < nearest)) return;
        nearest = squared;
        owners.plant[i] = before[k];
      });
    }
    if (owners.plant == before) break;
  }
}

}  // namespace

PointOwners findIsolatedPoints(const Block& block, const NeighborGrid& grid,
                               const std::vector<StemAxis>& axes, const PointOwners& known) {
  const std::vector<std::int32_t> none(block.isolated.size(), -1);
  PointOwners owners{none, none};
  if (block.isolated.empty() || axes.empty()) return owners;
  constexpr float kCell = 0.05F;  // [m]
  const NeighborGrid isolated(block.isolated.points, kCell);
  giveToStems(block, grid, isolated, axes, known, owners);
  const float reach = reachOfPlants(block, grid);
  if (reach > 0.0F) giveToPlants(block, grid, isolated, reach, known, owners);
  return owners;
}

}  // namespace field_phenotyping
