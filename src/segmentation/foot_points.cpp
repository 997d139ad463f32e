#include "field_phenotyping/segmentation/foot_points.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <tuple>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/robust_spread.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"

namespace field_phenotyping {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kReach = 0.035F;  // [m] of a foot about the stem's surface

/// A stem's point not far above the soil.
struct LowPoint {
  float height;  // above the soil [m]
  float off;     // outside the axis' radius there [m]
};

constexpr float kLowest = 0.03F;  // [m] above the soil: below it soil has been taken out
constexpr float kHighest = 0.50F;

/// What is known of a stem just above the soil.
struct LowStem {
  float radius;   // [m]
  float stddev;   // of its points about the surface [m]
  float density;  // of its points along the axis [1/m]
};

/// From its lowest points: those of the lowest decimetre, and of more where they are few.
/// @param radius of the axis at the soil [m]
std::optional<LowStem> lowStemOf(std::vector<LowPoint> points, float radius) {
  constexpr std::size_t kFew = 6U;
  constexpr std::size_t kEnough = 12U;
  constexpr float kLow = 0.15F;           // [m]
  constexpr float kLeastNoise = 0.0015F;  // [m]
  if (points.size() < kFew) return std::nullopt;
  std::sort(points.begin(), points.end(), [](const LowPoint& a, const LowPoint& b) {
    return std::tie(a.height, a.off) < std::tie(b.height, b.off);
  });
  std::vector<float> off;
  float highest = kLow;
  for (const LowPoint& point : points) {
    if (point.height > kLow && off.size() >= kEnough) break;
    off.push_back(point.off);
    highest = std::max(highest, point.height);
  }
  const RobustSpread spread = robustSpreadOf(off, kLeastNoise);
  return LowStem{radius + spread.middle, spread.stddev,
                 static_cast<float>(off.size()) / (highest - kLowest)};
}

/// A point near a foot.
struct Candidate {
  std::uint32_t index;  // in the block's feet
  float distance;       // from the stem's axis [m]
  float height;         // above the soil model [m]
};

/// The soil round a foot, from the candidates well outside the stem.
struct NearSoil {
  float height;   // above the soil model [m]
  float stddev;   // [m]
  float density;  // of its points [1/m^2]
};

NearSoil soilAround(const std::vector<Candidate>& candidates, const LowStem& stem, float stddev) {
  constexpr std::size_t kFew = 8U;
  constexpr float kClear = 3.0F;          // standard deviations from the stem's surface
  constexpr float kLeastRough = 0.0015F;  // [m]
  const float inner = stem.radius + kClear * stem.stddev;
  const float outer = stem.radius + kReach;
  std::vector<float> heights;
  for (const Candidate& candidate : candidates) {
    if (candidate.distance > inner && candidate.distance < outer)
      heights.push_back(candidate.height);
  }
  const float area = kPi * std::max(outer * outer - inner * inner, stem.radius * stem.radius);
  const auto count = static_cast<float>(std::max(heights.size(), kFew));
  if (heights.size() < kFew) return {0.0F, stddev, count / area};
  const RobustSpread spread = robustSpreadOf(heights, kLeastRough);
  return {spread.middle, spread.stddev, count / area};
}

}  // namespace

std::vector<std::int32_t> findFootPoints(const Block& block, const std::vector<StemAxis>& axes,
                                         const std::vector<std::int32_t>& stem_owner) {
  std::vector<std::int32_t> owner(block.feet.size(), -1);
  if (block.feet.empty()) return owner;
  const auto heightOf = [&](std::size_t i) {
    return block.ground.heightAbove(block.cloud.points[i]);
  };
  const std::vector<std::uint32_t> low = indicesWhere(stem_owner.size(), [&](std::size_t i) {
    if (stem_owner[i] < 0) return false;
    const float height = heightOf(i);
    return !(height < kLowest || height > kHighest);
  });
  std::vector<std::vector<std::uint32_t>> low_of(axes.size());
  for (const std::uint32_t i : low) low_of[static_cast<std::size_t>(stem_owner[i])].push_back(i);
  const NeighborGrid grid(block.feet.points, kReach);
  /// A candidate that is a stem's rather than the soil's.
  struct Claim {
    std::uint32_t index;
    float density;  // of the stem's points there [1/m^3]
  };
  std::vector<std::vector<Claim>> claims(axes.size());
  parallelFor(axes.size(), [&](std::size_t s) {
    const StemAxis& axis = axes[s];
    std::vector<LowPoint> points;
    for (const std::uint32_t i : low_of[s]) {
      const StemAxis::Projection at = axis.project(block.cloud.points[i]);
      points.push_back({heightOf(i), at.distance - at.radius});
    }
    const Eigen::Vector3f base = baseOf(block, axis);
    const std::optional<LowStem> stem = lowStemOf(std::move(points), axis.project(base).radius);
    if (!stem) return;
    std::vector<Candidate> candidates;
    grid.forEachWithin(base, stem->radius + kReach, [&](std::uint32_t i, float) {
      const Eigen::Vector3f& p = block.feet.points[i];
      candidates.push_back({i, axis.project(p).distance, block.ground.heightAbove(p)});
    });
    const NearSoil soil = soilAround(candidates, *stem, block.ground.stddevAt(base.x(), base.y()));
    for (const Candidate& candidate : candidates) {
      // Points a volume: [1/m^3].
      const float outside = (candidate.distance - stem->radius) / stem->stddev;
      const float height = (candidate.height - soil.height) / soil.stddev;
      const float of_stem = stem->density * normalShareBelow(height) *
                            normalDensity(candidate.distance - stem->radius, stem->stddev) /
                            (2.0F * kPi * std::max(candidate.distance, stem->radius));
      const float of_soil = soil.density * normalShareBelow(outside) *
                            normalDensity(candidate.height - soil.height, soil.stddev);
      if (of_stem > of_soil) claims[s].push_back({candidate.index, of_stem});
    }
  });
  std::vector<float> best(block.feet.size(), 0.0F);
  for (std::size_t s = 0; s < axes.size(); ++s) {
    for (const Claim& claim : claims[s]) {
      if (!(claim.density > best[claim.index])) continue;
      best[claim.index] = claim.density;
      owner[claim.index] = static_cast<std::int32_t>(s);
    }
  }
  return owner;
}

}  // namespace field_phenotyping
