#include "field_phenotyping/segmentation/detached_tops.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

/// The points of a block's cloud and, after them, those that were taken out as outliers.
class OwnedPoints {
 public:
  OwnedPoints(const Block& block, PointOwners& owners, PointOwners& isolated)
      : block_(block), owners_(owners), isolated_(isolated) {}

  std::uint32_t size() const {
    return static_cast<std::uint32_t>(owners_.plant.size() + isolated_.plant.size());
  }
  const Eigen::Vector3f& at(std::uint32_t i) const {
    return isOfCloud(i) ? block_.cloud.points[i] : block_.isolated.points[i - ofCloud()];
  }
  std::int32_t ownerOf(std::uint32_t i) const {
    return isOfCloud(i) ? owners_.of(i) : isolated_.of(i - ofCloud());
  }
  bool isStem(std::uint32_t i) const {
    return (isOfCloud(i) ? owners_.stem[i] : isolated_.stem[i - ofCloud()]) >= 0;
  }
  void give(std::uint32_t i, std::int32_t plant) {
    PointOwners& owners = isOfCloud(i) ? owners_ : isolated_;
    const std::uint32_t at = isOfCloud(i) ? i : i - ofCloud();
    owners.stem[at] = -1;
    owners.plant[at] = plant;
  }

 private:
  std::uint32_t ofCloud() const { return static_cast<std::uint32_t>(owners_.plant.size()); }
  bool isOfCloud(std::uint32_t i) const { return i < ofCloud(); }

  const Block& block_;
  PointOwners& owners_;
  PointOwners& isolated_;
};

constexpr float kBelow = 0.15F;  // [m] that shows how densely a plant is seen

/// The upper part of every plant.
struct UpperPart {
  float top = std::numeric_limits<float>::lowest();  // [m]
  float bottom = std::numeric_limits<float>::max();  // [m] of the whole plant
  float lowest = 0.0F;                               // [m] that a detached top may begin at
  std::vector<std::uint32_t> points;                 // above it and a little below, downwards
};

std::vector<UpperPart> findUpperParts(const OwnedPoints& points, std::size_t plants) {
  constexpr float kUpper = 0.35F;  // share of a plant's height
  std::vector<UpperPart> parts(plants);
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const std::int32_t plant = points.ownerOf(i);
    if (plant < 0) continue;
    UpperPart& part = parts[static_cast<std::size_t>(plant)];
    part.top = std::max(part.top, points.at(i).z());
    part.bottom = std::min(part.bottom, points.at(i).z());
  }
  for (UpperPart& part : parts) part.lowest = part.top - kUpper * (part.top - part.bottom);
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const std::int32_t plant = points.ownerOf(i);
    if (plant < 0) continue;
    UpperPart& part = parts[static_cast<std::size_t>(plant)];
    if (points.at(i).z() > part.lowest - kBelow) part.points.push_back(i);
  }
  parallelFor(plants, [&](std::size_t plant) {
    std::vector<std::uint32_t>& own = parts[plant].points;
    std::sort(own.begin(), own.end(), [&](std::uint32_t a, std::uint32_t b) {
      const float za = points.at(a).z();
      const float zb = points.at(b).z();
      return za != zb ? za > zb : a < b;
    });
  });
  return parts;
}

/// What stands above a gap in which points were to be expected.
struct DetachedTop {
  std::size_t count = 0U;  // of the plant's highest points; 0: there is no such gap
  std::int32_t to = -1;    // the other plant that is near; -1: none
  float gap = 0.0F;        // [m] below it
  float drop = 0.0F;       // [m] of the plant's top
};

/// The other plant that most of these points are nearest to, among those within reach; -1 if there
/// is none.
std::int32_t nearestOther(const OwnedPoints& points, const NeighborGrid& grid,
                          const std::uint32_t* begin, const std::uint32_t* end, float reach) {
  const std::int32_t plant = points.ownerOf(*begin);
  std::map<std::int32_t, std::size_t> votes;
  for (const std::uint32_t* i = begin; i != end; ++i) {
    float least = std::numeric_limits<float>::max();
    std::int32_t nearest = -1;
    grid.forEachWithin(points.at(*i), reach, [&](std::uint32_t k, float squared) {
      const std::int32_t owner = points.ownerOf(k);
      if (owner < 0 || owner == plant || !(squared < least)) return;
      least = squared;
      nearest = owner;
    });
    if (nearest >= 0) ++votes[nearest];
  }
  std::int32_t most = -1;
  for (const auto& [other, count] : votes) {
    if (most < 0 || count > votes[most]) most = other;
  }
  return most;
}

/// The longest gap between points of a plant's upper part [m]; 0 of a point or none.
float longestGap(const OwnedPoints& points, const UpperPart& part) {
  float longest = 0.0F;
  for (std::size_t k = 1; k < part.points.size(); ++k) {
    const float above = points.at(part.points[k - 1U]).z();
    if (above < part.lowest) break;
    longest = std::max(longest, above - points.at(part.points[k]).z());
  }
  return longest;
}

/// The least gap that parts a top from its plant [m], in a stand as well seen as this one.
float leastGap(const OwnedPoints& points, const std::vector<UpperPart>& parts) {
  constexpr float kLeast = 0.06F;  // [m]
  constexpr float kTimes = 1.5F;   // the longest that plants usually have
  std::vector<float> longest(parts.size());
  parallelFor(parts.size(),
              [&](std::size_t plant) { longest[plant] = longestGap(points, parts[plant]); });
  return longest.empty() ? kLeast : std::max(kLeast, kTimes * medianOf(std::move(longest)));
}

DetachedTop findDetachedTop(const OwnedPoints& points, const NeighborGrid& grid,
                            const UpperPart& part, float least_gap) {
  constexpr float kExpected = 8.0F;   // points in the gap
  constexpr float kNear = 0.4F;       // of the gap: another plant's points
  constexpr float kFarthest = 0.12F;  // [m]
  // One point in so many may be of the stem, which has followed the neighbour's.
  constexpr std::size_t kFewStem = 10U;
  DetachedTop detached;
  const std::vector<std::uint32_t>& own = part.points;
  std::size_t stem = 0U;   // points of the stem above the gap
  std::size_t below = 0U;  // first point that is more than kBelow under the gap
  for (std::size_t k = 1; k < own.size(); ++k) {
    if (points.isStem(own[k - 1U])) ++stem;
    const float above = points.at(own[k - 1U]).z();
    if (above < part.lowest) break;
    const float end = points.at(own[k]).z();
    const float gap = above - end;
    if (gap < least_gap || kFewStem * stem > k) continue;
    while (below < own.size() && points.at(own[below]).z() > end - kBelow) ++below;
    if (static_cast<float>(below - k) * gap < kExpected * kBelow) continue;
    const std::int32_t to =
        nearestOther(points, grid, own.data(), own.data() + k, std::min(kNear * gap, kFarthest));
    if (to >= 0 || detached.to < 0) detached = {k, to, gap, part.top - end};
  }
  return detached;
}

/// Share of the tops near other plants that are their own plant's. Where tops are badly seen they
/// have such gaps too, and then about as many have no other plant near as have one.
float shareByChance(const std::vector<DetachedTop>& detached) {
  constexpr float kLeast = 0.1F;  // in stands that are well seen
  float near = 0.0F;
  float alone = 0.0F;
  for (const DetachedTop& top : detached) {
    if (top.count > 0U) (top.to >= 0 ? near : alone) += 1.0F;
  }
  return std::max(kLeast, alone / std::max(near, 1.0F));
}

}  // namespace

std::vector<float> giveDetachedTops(const Block& block, const NeighborGrid& grid,
                                    std::size_t plants, PointOwners& owners,
                                    PointOwners& isolated) {
  constexpr float kMostByChance = 0.5F;
  OwnedPoints points(block, owners, isolated);
  const std::vector<UpperPart> parts = findUpperParts(points, plants);
  const float least_gap = leastGap(points, parts);
  std::vector<DetachedTop> detached(plants);
  parallelFor(plants, [&](std::size_t plant) {
    detached[plant] = findDetachedTop(points, grid, parts[plant], least_gap);
  });
  std::vector<float> moved(plants, 0.0F);  // [m] of each top
  const float by_chance = shareByChance(detached);
  if (by_chance >= kMostByChance) return moved;
  for (std::size_t plant = 0; plant < plants; ++plant) {
    const DetachedTop& top = detached[plant];
    if (top.to < 0) continue;
    const auto to = static_cast<std::size_t>(top.to);
    // What would raise that one too by so much is as little its own.
    const float rise = parts[plant].top - parts[to].top;
    const bool fits = rise < top.gap;
    for (std::size_t k = 0; k < top.count; ++k) {
      points.give(parts[plant].points[k], fits ? top.to : -1);
    }
    moved[plant] = std::max(moved[plant], top.drop);
    if (fits) moved[to] = std::max(moved[to], rise);
  }
  for (float& doubt : moved) doubt *= std::sqrt(by_chance);
  return moved;
}

}  // namespace field_phenotyping
