#include "field_phenotyping/segmentation/stem_continuation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr float kStep = 0.02F;   // [m] along the organ
constexpr float kReach = 0.03F;  // [m] about the place foretold, in which the organ is looked for

/// Half the width of the tube that a spike's points lie in [m].
float tubeRadius(float noise) {
  constexpr float kSpike = 0.010F;  // [m] its radius, with spikelets
  constexpr float kPerNoise = 1.5F;
  return kSpike + kPerNoise * noise;
}

/// Points that no stem holds, above the lowest end of a stem.
std::vector<std::uint32_t> pointsAbove(const std::vector<Eigen::Vector3f>& points,
                                       const std::vector<StemAxis>& axes,
                                       const std::vector<std::int32_t>& owner) {
  float lowest = std::numeric_limits<float>::max();
  for (const StemAxis& axis : axes) {
    if (!axis.empty()) lowest = std::min(lowest, axis.nodes().back().position.z());
  }
  return indicesWhere(points.size(),
                      [&](std::size_t i) { return owner[i] < 0 && points[i].z() > lowest; });
}

/// A straight bit of the organ.
struct Stretch {
  Eigen::Vector3f from;
  Eigen::Vector3f direction;
  float points = 0.0F;  // that show it: each counts the less, the farther from its line it lies
};

/// The organ that carries on an axis, stretch by stretch of kStep.
std::vector<Stretch> follow(const std::vector<Eigen::Vector3f>& points, const NeighborGrid& grid,
                            const StemAxis& axis, float tube) {
  constexpr float kTrend = 0.2F;        // [m] of the stem that shows where it points
  constexpr float kLongest = 0.6F;      // [m] of a tassel
  constexpr float kLeastCosine = 0.7F;  // of its turn from the stem's direction
  constexpr float kLeastPoints = 0.5F;  // of a step that is not empty
  constexpr float kCleanShare = 0.6F;   // of the points about a step, that lie on the organ
  constexpr float kShift = 0.5F;        // share of the offset that the place moves by
  constexpr float kTurn = 0.15F;        // share of a step's turn that is believed
  // A gap is as wide as chance may leave it, by the points that the organ had so far.
  constexpr float kMissedPoints = 8.0F;
  constexpr float kNarrowGap = 2.0F;        // steps, that may always be empty
  constexpr float kWideGap = 5.0F;          // steps, more never
  constexpr std::size_t kAfterGap = 2U;     // clean steps that must follow on
  constexpr std::size_t kMostCrossed = 5U;  // steps: what crosses is soon passed
  const float length = axis.length();
  const Eigen::Vector3f end = axis.pointAt(length);
  const Eigen::Vector3f upwards =
      (end - axis.pointAt(std::max(0.0F, length - kTrend))).normalized();
  Eigen::Vector3f place = end;
  Eigen::Vector3f direction = upwards;
  std::vector<Stretch> stretches;
  std::size_t sure = 0U;         // stretches of the organ
  std::size_t last = 0U;         // stretches up to the last that is not empty
  std::size_t last_clean = 0U;   // stretches up to the last that shows the organ alone
  std::size_t clean_after = 0U;  // clean steps since the gap
  float seen = 0.0F;             // points of the organ
  bool gap = false;
  while (static_cast<float>(stretches.size()) * kStep < kLongest) {
    const Eigen::Vector3f middle = place + 0.5F * kStep * direction;
    Eigen::Vector3f offset = Eigen::Vector3f::Zero();
    float weights = 0.0F;
    float count = 0.0F;
    grid.forEachWithin(middle, kReach, [&](std::uint32_t i, float) {
      const Eigen::Vector3f away = points[i] - middle;
      const float along = away.dot(direction);
      if (std::abs(along) > 0.5F * kStep) return;
      const Eigen::Vector3f aside = away - along * direction;
      const float weight = std::exp(-0.5F * aside.squaredNorm() / (tube * tube));
      offset += weight * aside;
      weights += weight;
      count += 1.0F;
    });
    stretches.push_back({place, direction, weights});
    if (weights > kLeastPoints) {
      const bool is_clean = weights > kCleanShare * count;
      seen += weights;
      last = stretches.size();
      if (is_clean) ++clean_after;
      if (!gap || clean_after >= kAfterGap) {
        gap = false;
        sure = stretches.size();
        if (is_clean) last_clean = sure;
      }
      const Eigen::Vector3f shift = kShift / weights * offset;
      direction = (direction + kTurn / kStep * shift).normalized();
      place += kStep * direction + shift;
    } else {
      if (!gap) clean_after = 0U;
      gap = true;
      place += kStep * direction;
    }
    const auto empty = static_cast<float>(stretches.size() - last);
    const bool is_chance = empty * seen <= kMissedPoints * static_cast<float>(last);
    if (empty > kWideGap || (empty > kNarrowGap && !is_chance)) break;
    if (direction.dot(upwards) < kLeastCosine) break;
  }
  if (last_clean > 0U && sure - last_clean <= kMostCrossed) sure = last_clean;
  stretches.resize(sure);
  return stretches;
}

/// @param stretches not empty
OrganEnd endOf(const std::vector<Stretch>& stretches) {
  constexpr std::size_t kLast = 5U;        // stretches
  constexpr float kStraight = 0.95F;       // cosine of the farthest turn
  constexpr float kPointsAStretch = 1.5F;  // below it a tip may well have no point
  const Stretch& last = stretches.back();
  const Eigen::Vector3f place = last.from + kStep * last.direction;
  const std::size_t begin = stretches.size() - std::min(stretches.size(), kLast);
  OrganEnd end{place, (place - stretches[begin].from).normalized(), true};
  float seen = 0.0F;
  for (std::size_t k = begin; k < stretches.size(); ++k) seen += stretches[k].points;
  if (seen < kPointsAStretch * static_cast<float>(stretches.size() - begin)) end.is_clear = false;
  for (const Stretch& stretch : stretches) {
    if (stretch.direction.dot(stretches.front().direction) < kStraight) end.is_clear = false;
  }
  return end;
}

}  // namespace

std::vector<OrganEnd> followStemsUp(const Block& block, const std::vector<StemAxis>& axes,
                                    float noise, std::vector<std::int32_t>& owner) {
  std::vector<OrganEnd> ends(axes.size());
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    if (!axes[plant].empty()) ends[plant].place = axes[plant].nodes().back().position;
  }
  const std::vector<std::uint32_t> above = pointsAbove(block.cloud.points, axes, owner);
  if (above.empty()) return ends;
  const std::vector<Eigen::Vector3f> points = valuesAt(block.cloud.points, above);
  std::vector<std::uint8_t> has_stem(axes.size(), 0U);
  for (const std::int32_t plant : owner) {
    if (plant >= 0) has_stem[static_cast<std::size_t>(plant)] = 1U;
  }
  const NeighborGrid grid(points, kReach);
  const float tube = tubeRadius(noise);
  /// A point that may be of what carries on a plant's stem.
  struct Claim {
    std::uint32_t point;
    float aside;  // [m] of the middle of the organ
  };
  std::vector<std::vector<Claim>> claims(axes.size());
  parallelFor(axes.size(), [&](std::size_t plant) {
    if (has_stem[plant] == 0U) return;
    const std::vector<Stretch> stretches = follow(points, grid, axes[plant], tube);
    if (!stretches.empty()) ends[plant] = endOf(stretches);
    for (const Stretch& stretch : stretches) {
      const Eigen::Vector3f middle = stretch.from + 0.5F * kStep * stretch.direction;
      grid.forEachWithin(middle, kReach, [&](std::uint32_t i, float) {
        const Eigen::Vector3f away = points[i] - middle;
        const float along = away.dot(stretch.direction);
        if (std::abs(along) > 0.6F * kStep) return;
        const float aside = (away - along * stretch.direction).norm();
        if (aside < tube) claims[plant].push_back({i, aside});
      });
    }
  });
  std::vector<float> least(points.size(), tube);
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    for (const Claim& claim : claims[plant]) {
      if (claim.aside >= least[claim.point]) continue;
      least[claim.point] = claim.aside;
      owner[above[claim.point]] = static_cast<std::int32_t>(plant);
    }
  }
  return ends;
}

}  // namespace field_phenotyping
