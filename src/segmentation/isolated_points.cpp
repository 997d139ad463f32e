#include "field_phenotyping/segmentation/isolated_points.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>

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

/// The nearest of the points that count within `reach`; none where there is none.
template <class Counts>
std::optional<std::uint32_t> nearestWithin(const NeighborGrid& grid, const Eigen::Vector3f& place,
                                           float reach, const Counts& counts) {
  std::optional<std::uint32_t> nearest;
  float least = std::numeric_limits<float>::infinity();
  grid.forEachWithin(place, reach, [&](std::uint32_t k, float squared) {
    if (!counts(k) || !(squared < least)) return;
    least = squared;
    nearest = k;
  });
  return nearest;
}

/// Gives the rest of them to the plants that they are next to.
void giveToPlants(const Block& block, const NeighborGrid& grid, const NeighborGrid& isolated,
                  float reach, const PointOwners& known, PointOwners& owners) {
  const std::vector<Eigen::Vector3f>& points = block.isolated.points;
  std::vector<std::uint32_t> alone;  // next to no point of the block's cloud
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if (owners.plant[i] >= 0) continue;
    const auto next = nearestWithin(grid, points[i], reach, [](std::uint32_t) { return true; });
    if (next) {
      owners.plant[i] = known.of(*next);
    } else {
      alone.push_back(i);
    }
  }
  // Those of a sparse tip that lie next to such a point only.
  constexpr int kMostInARow = 4;
  for (int round = 0; round < kMostInARow; ++round) {
    const std::vector<std::int32_t> before = owners.plant;
    for (const std::uint32_t i : alone) {
      if (before[i] >= 0) continue;
      const auto next = nearestWithin(isolated, points[i], reach,
                                      [&](std::uint32_t k) { return before[k] >= 0; });
      if (next) owners.plant[i] = before[*next];
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
