#include "field_phenotyping/segmentation/detached_tops.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>
#include <utility>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"
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

/// The upper part of a plant.
struct UpperPart {
  float top = std::numeric_limits<float>::lowest();  // [m]
  float bottom = std::numeric_limits<float>::max();  // [m] of the whole plant
  std::vector<std::uint32_t> points;                 // downwards

  /// Height [m] as far below the top as this share of the whole plant.
  float below(float share) const { return top - share * (top - bottom); }
};

constexpr float kUpper = 0.40F;  // share of a plant; what is lower is no part of a detached top

std::vector<UpperPart> findUpperParts(const OwnedPoints& points, std::size_t plants) {
  constexpr float kWithRest = 0.45F;  // share of a plant: some of the rest, that ways down lead to
  std::vector<UpperPart> parts(plants);
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const std::int32_t plant = points.ownerOf(i);
    if (plant < 0) continue;
    UpperPart& part = parts[static_cast<std::size_t>(plant)];
    part.top = std::max(part.top, points.at(i).z());
    part.bottom = std::min(part.bottom, points.at(i).z());
  }
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const std::int32_t plant = points.ownerOf(i);
    if (plant < 0) continue;
    UpperPart& part = parts[static_cast<std::size_t>(plant)];
    if (points.at(i).z() >= part.below(kWithRest)) part.points.push_back(i);
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

/// The way from a plant's highest point to the rest of it, from point to point.
struct WayDown {
  float gap = 0.0F;                  // [m] the longest step that it cannot do without
  std::vector<std::uint32_t> above;  // the points before that step, the highest first
};

/// Places that the way down has not come to yet, from high to low, coordinate by coordinate: each
/// step looks at many of them.
class OpenPlaces {
 public:
  /// All but the first.
  OpenPlaces(const OwnedPoints& points, const std::vector<std::uint32_t>& own)
      : ranks_(own.size() - 1U) {
    std::iota(ranks_.begin(), ranks_.end(), std::size_t{1});
    for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(own.size() + kLanes);
    for (std::size_t k = 0; k < ranks_.size(); ++k) {
      const Eigen::Vector3f& place = points.at(own[ranks_[k]]);
      x_[k] = place.x();
      y_[k] = place.y();
      z_[k] = place.z();
    }
  }

  /// Takes out those within a gap [m] and calls visit(rank, height) for each.
  template <class Visit>
  void takeWithin(const Eigen::Vector3f& from, float gap, Visit&& visit) {
    const auto end = z_.begin() + static_cast<std::ptrdiff_t>(ranks_.size());
    const auto low =
        std::partition_point(z_.begin(), end, [&](float z) { return !(from.z() - z > gap); });
    const auto high =
        std::partition_point(z_.begin(), low, [&](float z) { return z - from.z() > gap; });
    const auto last = static_cast<std::size_t>(low - z_.begin());
    for (auto k = static_cast<std::size_t>(high - z_.begin()); k < last; k += kLanes) {
      const Floats x = loadFloats(&x_[k]) - from.x();
      const Floats y = loadFloats(&y_[k]) - from.y();
      const Floats z = loadFloats(&z_[k]) - from.z();
      const Integers near = lanesBefore(last - k) & (x * x + (y * y + z * z) <= gap * gap);
      if (!anyOf(near)) continue;
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        if (near[lane] == 0) continue;
        x_[k + lane] = kTaken;
        visit(ranks_[k + lane], z_[k + lane]);
      }
    }
  }

  /// Forgets those that have been taken.
  void close() {
    std::size_t kept = 0U;
    for (std::size_t k = 0; k < ranks_.size(); ++k) {
      if (x_[k] == kTaken) continue;
      x_[kept] = x_[k];
      y_[kept] = y_[k];
      z_[kept] = z_[k];
      ranks_[kept] = ranks_[k];
      ++kept;
    }
    ranks_.resize(kept);
  }

 private:
  static constexpr float kTaken = std::numeric_limits<float>::infinity();  // far from any

  std::vector<float> x_, y_, z_;  // padded so that the last lanes can be loaded
  std::vector<std::size_t> ranks_;
};

/// Goes down in steps that get longer until they lead to the rest.
WayDown findWayDown(const OwnedPoints& points, const UpperPart& part) {
  constexpr float kFirstStep = 0.012F;  // [m]
  constexpr float kLongestStep = 0.32F;
  constexpr float kLonger = 1.12F;
  constexpr std::size_t kMost = 1500U;  // more are no top
  const std::vector<std::uint32_t>& own = part.points;
  WayDown way;
  if (own.empty()) return way;
  const float rest = part.below(kUpper);
  OpenPlaces open(points, own);
  std::vector<std::size_t> front{0U};
  bool has_arrived = false;
  const auto reach = [&](std::size_t rank, float height) {
    front.push_back(rank);
    has_arrived = has_arrived || height < rest;
  };
  for (way.gap = kFirstStep; way.gap < kLongestStep; way.gap *= kLonger) {
    const std::size_t before = front.size();
    const auto isDone = [&] { return has_arrived || front.size() > kMost; };
    for (std::size_t next = 0U; next < front.size() && !isDone(); ++next) {
      open.takeWithin(points.at(own[front[next]]), way.gap, reach);
    }
    if (isDone()) {
      front.resize(before);
      break;
    }
    open.close();
  }
  for (const std::size_t k : front) way.above.push_back(own[k]);
  return way;
}

/// What stands above a longer gap than plants of the stand usually have.
struct DetachedTop {
  std::vector<std::uint32_t> points;
  std::int32_t to = -1;  // the other plant that is near; -1: none
  float gap = 0.0F;      // [m] below it
  float top = 0.0F;      // [m]
  float next = 0.0F;     // [m] what is highest of the plant without it
};

/// How near another plant must be to what stands above a gap [m]: the longer the gap is for this
/// stand, the less. @param usual gap [m]
float reachOver(float gap, float usual) {
  constexpr float kNear = 0.5F;       // of the gap
  constexpr float kFarthest = 0.12F;  // [m]
  constexpr float kLong = 3.0F;       // usual ones: what is nearer to another plant is that one's
  return std::min(gap < kLong * usual ? kNear * gap : gap, kFarthest);
}

/// The other plant that most of these points are nearest to; -1 if less than half of them have
/// one within reach.
std::int32_t nearestOther(const OwnedPoints& points, const NeighborGrid& grid,
                          const std::vector<std::uint32_t>& top, float reach) {
  constexpr std::size_t kOneIn = 2U;
  const std::int32_t plant = points.ownerOf(top.front());
  std::map<std::int32_t, std::size_t> votes;
  std::size_t near = 0U;
  for (const std::uint32_t i : top) {
    float least = std::numeric_limits<float>::max();
    std::int32_t nearest = -1;
    grid.forEachWithin(points.at(i), reach, [&](std::uint32_t k, float squared) {
      const std::int32_t owner = points.ownerOf(k);
      if (owner < 0 || owner == plant || !(squared < least)) return;
      least = squared;
      nearest = owner;
    });
    if (nearest < 0) continue;
    ++votes[nearest];
    ++near;
  }
  std::int32_t most = -1;
  if (kOneIn * near < top.size()) return most;
  for (const auto& [other, count] : votes) {
    if (most < 0 || count > votes[most]) most = other;
  }
  return most;
}

/// What stands above gaps of a plant, one below the other: all but the last are near other plants.
/// @param way down the part
/// @param usual gap in this stand [m]
std::vector<DetachedTop> findDetachedTops(const OwnedPoints& points, const NeighborGrid& grid,
                                          UpperPart part, WayDown way, float usual) {
  constexpr float kLeastGap = 0.02F;  // [m]
  constexpr float kTimes = 1.5F;      // the usual gap
  constexpr std::size_t kMostTops = 4U;
  constexpr std::size_t kMostPoints = 400U;  // of a branch or the end of a leaf
  // One point in so many may be of the stem, which has followed the neighbour's.
  constexpr std::size_t kFewStem = 10U;
  const float least_gap = std::max(kLeastGap, kTimes * usual);
  std::vector<DetachedTop> tops;
  while (!way.above.empty() && way.gap >= least_gap && way.above.size() <= kMostPoints) {
    std::size_t stem = 0U;
    for (const std::uint32_t i : way.above) stem += points.isStem(i) ? 1U : 0U;
    if (kFewStem * stem > way.above.size()) break;
    DetachedTop top;
    top.to = nearestOther(points, grid, way.above, reachOver(way.gap, usual));
    top.gap = way.gap;
    top.top = points.at(way.above.front()).z();
    top.points = std::move(way.above);
    std::vector<std::uint32_t> gone = top.points;
    std::sort(gone.begin(), gone.end());
    part.points.erase(std::remove_if(part.points.begin(), part.points.end(),
                                     [&](std::uint32_t i) {
                                       return std::binary_search(gone.begin(), gone.end(), i);
                                     }),
                      part.points.end());
    if (part.points.empty()) break;
    top.next = points.at(part.points.front()).z();
    tops.push_back(std::move(top));
    if (tops.back().to < 0 || tops.size() == kMostTops) break;
    way = findWayDown(points, part);
  }
  return tops;
}

/// How often tops near other plants are their own plant's.
class Chance {
 public:
  /// @param share_near of the plants without a detached top whose highest points have another plant
  /// as near as those have
  Chance(const std::vector<std::vector<DetachedTop>>& detached, float share_near)
      : odds_(share_near / std::max(1.0F - share_near, kLeastAlone)) {
    for (const std::vector<DetachedTop>& tops : detached) {
      for (const DetachedTop& top : tops) (top.to >= 0 ? near_ : alone_).push_back(top.gap);
    }
  }

  /// Share of those above gaps as long as this or longer. Tops with no other plant near are their
  /// own plant's, and others would be beside them as often as beside any top.
  float shareAbove(float gap) const {
    constexpr float kLeast = 0.1F;  // in stands that are well seen
    return std::max(kLeast,
                    odds_ * countAbove(alone_, gap) / std::max(countAbove(near_, gap), 1.0F));
  }

 private:
  static constexpr float kLeastAlone = 0.1F;  // of all tops

  static float countAbove(const std::vector<float>& gaps, float gap) {
    return static_cast<float>(
        std::count_if(gaps.begin(), gaps.end(), [&](float other) { return other >= gap; }));
  }

  float odds_;
  std::vector<float> near_, alone_;
};

/// Share of the plants without a detached top that have another plant as near to their highest
/// points as it would count for one.
float shareNear(const OwnedPoints& points, const NeighborGrid& grid,
                const std::vector<UpperPart>& parts,
                const std::vector<std::vector<DetachedTop>>& detached, float usual) {
  constexpr float kTop = 0.02F;  // [m]
  std::vector<float> gaps;
  for (const std::vector<DetachedTop>& tops : detached) {
    for (const DetachedTop& top : tops) gaps.push_back(top.gap);
  }
  if (gaps.empty()) return 0.0F;
  const float reach = reachOver(medianOf(std::move(gaps)), usual);
  float tried = 0.0F;
  float near = 0.0F;
  for (std::size_t plant = 0; plant < parts.size(); ++plant) {
    const UpperPart& part = parts[plant];
    if (!detached[plant].empty() || part.points.empty()) continue;
    std::vector<std::uint32_t> top;
    for (const std::uint32_t i : part.points) {
      if (points.at(i).z() < part.top - kTop) break;
      top.push_back(i);
    }
    tried += 1.0F;
    if (nearestOther(points, grid, top, reach) >= 0) near += 1.0F;
  }
  return near / std::max(tried, 1.0F);
}

}  // namespace

std::vector<float> giveDetachedTops(const Block& block, const NeighborGrid& grid,
                                    std::size_t plants, PointOwners& owners,
                                    PointOwners& isolated) {
  constexpr float kSparse = 0.045F;  // [m] where gaps are usually longer they tell nothing
  constexpr float kMostByChance = 0.5F;
  OwnedPoints points(block, owners, isolated);
  const std::vector<UpperPart> parts = findUpperParts(points, plants);
  std::vector<WayDown> ways(plants);
  parallelFor(plants, [&](std::size_t plant) { ways[plant] = findWayDown(points, parts[plant]); });
  std::vector<float> gaps;
  for (const WayDown& way : ways) gaps.push_back(way.gap);
  const float usual = gaps.empty() ? 0.0F : medianOf(std::move(gaps));
  std::vector<float> moved(plants, 0.0F);
  if (usual > kSparse) return moved;

  std::vector<std::vector<DetachedTop>> detached(plants);
  parallelFor(plants, [&](std::size_t plant) {
    detached[plant] = findDetachedTops(points, grid, parts[plant], std::move(ways[plant]), usual);
  });
  const Chance chance(detached, shareNear(points, grid, parts, detached, usual));
  for (std::size_t plant = 0; plant < plants; ++plant) {
    for (const DetachedTop& top : detached[plant]) {
      const float by_chance = chance.shareAbove(top.gap);
      if (top.to < 0 || by_chance >= kMostByChance) break;
      const auto to = static_cast<std::size_t>(top.to);
      // What would raise that one too by so much is as little its own.
      const float rise = top.top - parts[to].top;
      const bool fits = rise < top.gap;
      for (const std::uint32_t i : top.points) points.give(i, fits ? top.to : -1);
      const float doubt = std::sqrt(by_chance);
      moved[plant] = std::max(moved[plant], doubt * (parts[plant].top - top.next));
      if (fits) moved[to] = std::max(moved[to], doubt * rise);
    }
  }
  return moved;
}

}  // namespace field_phenotyping
