#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/team_order.hpp"
#include "field_phenotyping/segmentation/growth_task.hpp"

// The constrained region growth of one stem (paper 2.4.1, Step 2, Eq 1-5) for a team of threads
// (see team.hpp), on the CPU and on the GPU. The points round the stem are looked at once and put
// in order along its axis; then a sphere walks up each region, one for each group of the team,
// whose lanes sum over the points: the same bits whatever the team.

namespace field_phenotyping {
namespace growth {

/// How similarity falls with the distance beyond a stem's surface, in units of what noise and
/// out-of-roundness explain: exp(-kSoftness away^2).
constexpr float kSoftness = 0.10F;  // similarity 0.5 at two and a half standard deviations

/// That unit [m].
FIELD_PHENOTYPING_HD inline float scaleOf(float spread, float radius) {
  constexpr float kOutOfRound = 0.07F;
  return static_cast<float>(
      lengthOf(static_cast<double>(spread), static_cast<double>(kOutOfRound * radius)));
}

/// How far a point lies beyond the surface, in that unit. Nothing but the stem itself lies within.
FIELD_PHENOTYPING_HD inline float awayOf(const AxisProjection& at, float spread) {
  const float beyond = at.distance - at.radius;
  return (beyond > 0.0F ? beyond : 0.0F) / scaleOf(spread, at.radius);
}

FIELD_PHENOTYPING_HD inline float absolute(float value) {
  return value < 0.0F ? -value : value;
}

/// How alike a point so far off is to the stem, in [0, 1]: distance to the stem's surface, normal
/// across the axis, upright shape. Compared with M.
FIELD_PHENOTYPING_HD inline float similarityOf(const LocalShapeNumbers& shape,
                                               const AxisProjection& at, float away) {
  const auto on_surface =
      static_cast<float>(exponential(static_cast<double>(-kSoftness * away * away)));
  const float across = 1.0F - absolute(dotOf(shape.normal, at.direction));
  const float along = shape.linearity * absolute(dotOf(shape.direction, at.direction)) +
                      (1.0F - shape.linearity) * 0.5F;
  constexpr float kSurface = 0.5F;
  constexpr float kAcross = 0.2F;
  constexpr float kAlong = 0.3F;
  return on_surface * (kSurface + kAcross * across + kAlong * along);
}

/// w_p of Eq 1: points in dense, little curved surroundings say more about where the stem goes.
FIELD_PHENOTYPING_HD inline float directionWeight(const LocalShapeNumbers& shape) {
  constexpr float kFullDensity = 20.0F;  // neighbours beyond which density adds nothing
  const float density = static_cast<float>(shape.neighbors) / kFullDensity;
  return (density < 1.0F ? density : 1.0F) * (1.0F - 3.0F * shape.curvature);
}

}  // namespace growth

/// Growth of the regions of one stem. All members of the team make one, and come to every call.
template <class Team>
class RegionGrowth {
 public:
  FIELD_PHENOTYPING_HD RegionGrowth(const Team& team, const GrowthTask& task,
                                    const growth::Memory& memory, const growth::Scratch& scratch)
      : team_(team), task_(task), memory_(memory), scratch_(scratch) {}

  /// Looks at the points once: where they lie about the axis, how alike they are to the stem, times
  /// the probability that they are no leaf base's; and puts those that a region may take in order
  /// along the axis. All may read that once they have met again.
  FIELD_PHENOTYPING_HD void placePoints() {
    forOwn(0, task_.count, [&](int i) { memory_.placed[i] = placedOf(i); });
    team_.sync();
    const int count = teamPick(
        team_, task_.count, [&](int i) { return memory_.placed[i].similarity >= 0.0F; },
        [&](int i, int n) {
          memory_.keys[n] = {memory_.placed[i].arc_length, i};
        },
        scratch_.counts);
    count_ = count;
    const growth::Key* sorted = teamSort(
        team_, memory_.keys, memory_.other_keys, count,
        [](const growth::Key& a, const growth::Key& b) { return a.arc_length < b.arc_length; });
    forOwn(0, task_.count, [&](int i) { memory_.slots[i] = -1; });
    forOwn(count, growth::paddedOf(count), [&](int k) {
      for (float* values :
           {memory_.x, memory_.y, memory_.z, memory_.similarity, memory_.weight, memory_.arc_length,
            memory_.distance, memory_.radius, memory_.azimuth}) {
        values[k] = 0.0F;
      }
    });
    team_.sync();
    forOwn(0, count, [&](int k) { put(sorted[k].member, k); });
    team_.sync();
    teamPick(
        team_, task_.count, [&](int i) { return memory_.slots[i] >= 0; },
        [&](int i, int n) { memory_.by_index[n] = memory_.slots[i]; }, scratch_.counts);
    if (task_.base_count > 0) leaveLeavesOut();
    // Along the axis, z rises but for what bends mean: bounds for the search.
    if (team_.rank() == 0U) {
      for (int k = 0; k < count; ++k) {
        const float before = k > 0 ? memory_.highest[k - 1] : memory_.z[0];
        memory_.highest[k] = before > memory_.z[k] ? before : memory_.z[k];
      }
    }
    if (team_.rank() == team_.size() - 1U) {
      for (int k = count - 1; k >= 0; --k) {
        const float after = k + 1 < count ? memory_.lowest[k + 1] : memory_.z[k];
        memory_.lowest[k] = after < memory_.z[k] ? after : memory_.z[k];
      }
    }
  }

  /// Step 2: every region from its start point to its end point.
  FIELD_PHENOTYPING_HD void growRegions(const GrowthSettings& settings) {
    forOwn(0, task_.region_count * count_, [&](int i) { memory_.marks[i] = 0U; });
    team_.sync();
    for (int r = static_cast<int>(team_.group()); r < task_.region_count;
         r += static_cast<int>(team_.groups())) {
      growRegion(r, settings);
    }
    team_.sync();
  }

 protected:
  using Lanes = decltype(std::declval<const Team&>().lanes());
  using Float = typename Lanes::Float;

  /// visit(i) for those of begin ... end - 1 that are this member's, which are the same whatever
  /// the range.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forOwn(int begin, int end, const Visit& visit) const {
    const int size = static_cast<int>(team_.size());
    const int rank = static_cast<int>(team_.rank());
    const int after = begin % size;
    for (int i = begin + (rank >= after ? rank - after : rank + size - after); i < end; i += size) {
      visit(i);
    }
  }

  FIELD_PHENOTYPING_HD unsigned char* marksOf(int region) const {
    return memory_.marks + static_cast<std::size_t>(region) * static_cast<std::size_t>(count_);
  }

  Team team_;
  GrowthTask task_;
  growth::Memory memory_;
  growth::Scratch scratch_;
  int count_ = 0;  // of the points that may join

 private:
  FIELD_PHENOTYPING_HD std::uint32_t indexOf(int member) const {
    return task_.members == nullptr ? static_cast<std::uint32_t>(member) : task_.members[member];
  }

  FIELD_PHENOTYPING_HD growth::Placed placedOf(int member) const {
    const std::uint32_t i = indexOf(member);
    const Place& point = task_.points[i];
    const AxisProjection at = task_.axis.project(point);
    growth::Placed placed{at.arc_length, at.distance,         at.radius,
                          -1.0F,         point.x - at.foot.x, point.y - at.foot.y};
    const float away = growth::awayOf(at, task_.spread);
    if (away > task_.farthest) return placed;
    const float similarity = growth::similarityOf(task_.shapes[i], at, away);
    if (similarity >= task_.least) placed.similarity = similarity;
    return placed;
  }

  /// Copies what is known of a member to its place.
  FIELD_PHENOTYPING_HD void put(int member, int k) const {
    const growth::Placed& placed = memory_.placed[member];
    const std::uint32_t i = indexOf(member);
    const Place& point = task_.points[i];
    const LocalShapeNumbers& shape = task_.shapes[i];
    memory_.slots[member] = k;
    memory_.member[k] = member;
    memory_.x[k] = point.x;
    memory_.y[k] = point.y;
    memory_.z[k] = point.z;
    memory_.similarity[k] = placed.similarity;
    memory_.weight[k] = growth::directionWeight(shape);
    memory_.arc_length[k] = placed.arc_length;
    memory_.distance[k] = placed.distance;
    memory_.radius[k] = placed.radius;
    memory_.curvature[k] = shape.curvature;
    memory_.density[k] = static_cast<float>(shape.neighbors);
    const auto x = static_cast<double>(placed.away_x);
    const auto y = static_cast<double>(placed.away_y);
    const double across = lengthOf(x, y);
    memory_.cosine[k] = across > 0.0 ? static_cast<float>(x / across) : 1.0F;
    memory_.sine[k] = across > 0.0 ? static_cast<float>(y / across) : 0.0F;
    constexpr float kThinnest = 1e-4F;  // [m]
    const float radius = placed.radius > kThinnest ? placed.radius : kThinnest;
    // Noise moves points outwards on average, across a curved surface.
    const float noise = task_.spread / radius;
    memory_.departure[k] = placed.distance / radius - 1.0F - 0.5F * noise * noise;
    if (task_.base_count > 0) memory_.azimuth[k] = static_cast<float>(angleOf(x, y));
  }

  /// Lowers the similarity of what is likely a leaf base's.
  FIELD_PHENOTYPING_HD void leaveLeavesOut() const {
    const Lanes lanes = team_.lanes();
    const float blur = leaf::blurOf(task_.leaf_spread);
    const auto count = static_cast<std::size_t>(count_);
    const std::size_t step = kLanes * team_.groups();
    for (std::size_t k = kLanes * team_.group(); k < count; k += step) {
      const leaf::Places<Float> places{
          lanes.load(memory_.arc_length, k, count), lanes.load(memory_.azimuth, k, count),
          lanes.load(memory_.distance, k, count), lanes.load(memory_.radius, k, count)};
      const leaf::Influence<Float> influence =
          leaf::influenceOfAll(lanes, task_.leaf_bases, task_.base_count, places, blur);
      // Room of later steps.
      lanes.store(influence.leaf, memory_.of_curvature, k, count);
      lanes.store(influence.hidden, memory_.of_density, k, count);
    }
    team_.sync();
    forOwn(0, count_, [&](int k) {
      const float leaf = memory_.of_curvature[k];
      if (!(leaf > 0.0F)) return;
      const float stem =
          leaf::stemDensity(memory_.distance[k], memory_.radius[k], task_.leaf_spread);
      memory_.similarity[k] *= 1.0F - leaf::shareOf(leaf, memory_.of_density[k], stem);
    });
  }

  /// Index of the first place of those sorted that is at or above a height.
  FIELD_PHENOTYPING_HD int firstReaching(const float* heights, float z) const {
    int first = 0;
    for (int left = count_; left > 0;) {
      const int half = left / 2;
      if (heights[first + half] < z) {
        first += half + 1;
        left -= half + 1;
      } else {
        left = half;
      }
    }
    return first;
  }

  /// A sphere of radius r1 walks up the stem; points inside that are similar to it by M or more
  /// join. It stops past the region's end or after max_steps. All members of a group come.
  FIELD_PHENOTYPING_HD void growRegion(int r, const GrowthSettings& settings) const {
    const Lanes lanes = team_.lanes();
    const GrowthRegionTask& region = task_.regions[r];
    const float M = growth::regionM(region.share, settings.M);
    const Place line = differenceOf(region.end, region.start);
    const float line_squared = dotOf(line, line);
    unsigned char* const marks = marksOf(r);
    int reached_begin = 0;
    int reached_end = 0;
    int steps = 0;
    Place s_k = region.start;
    while (line_squared > 0.0F && steps < settings.max_steps) {
      // Points inside the sphere B(s_k, r1) that are like the stem are candidates and join.
      const float reach = settings.r1 + 1e-6F * (settings.r1 + growth::absolute(s_k.z));
      const int begin = firstReaching(memory_.highest, s_k.z - reach);
      const int end = firstReaching(memory_.lowest, s_k.z + reach);
      const Place mean = meanDirection(s_k, settings.r1, M, begin, end, marks);
      reached_begin = steps == 0 || begin < reached_begin ? begin : reached_begin;
      reached_end = steps == 0 || end > reached_end ? end : reached_end;
      ++steps;

      // a. Growth direction (Eq 1, 2).
      const Place to_end = differenceOf(region.end, s_k);
      const float distance = std::sqrt(dotOf(to_end, to_end));
      const float towards = distance > 0.0F ? settings.beta / distance : 0.0F;
      const Place v_k =
          movedAlong({settings.alpha * mean.x, settings.alpha * mean.y, settings.alpha * mean.z},
                     towards, to_end);
      // b. New seed (Eq 3); the step stays within [0.5, 1] r1 so that it can neither stall nor
      // skip.
      const float speed = std::sqrt(dotOf(v_k, v_k));
      if (!(speed > 0.0F)) break;
      s_k = movedAlong(s_k, settings.r1 * growth::within(speed, 0.5F, 1.0F) / speed, v_k);
      // c. Termination (Eq 4, 5).
      const float t_proj = dotOf(differenceOf(s_k, region.start), line) / line_squared;
      if (t_proj < 0.0F || t_proj > 1.0F) break;
    }
    if (lanes.first()) {
      growth::Region grown{};
      grown.begin = reached_begin;
      grown.end = reached_end > reached_begin ? reached_end : reached_begin;
      grown.steps = steps;
      memory_.regions[r] = grown;
    }
  }

  /// Eq 1: the weighted mean direction from s_k to the candidates, of those sorted points, which
  /// are marked; zero when there are none.
  FIELD_PHENOTYPING_HD Place meanDirection(const Place& s_k, float radius, float M, int begin,
                                           int end, unsigned char* marks) const {
    const Lanes lanes = team_.lanes();
    Float sum_x = lanes.all(0.0F);
    Float sum_y = sum_x;
    Float sum_z = sum_x;
    Float total = sum_x;
    const auto of = static_cast<std::size_t>(end > begin ? end : begin);
    for (auto k = static_cast<std::size_t>(begin); k < of; k += kLanes) {
      const Float x = lanes.load(memory_.x, k, of) - s_k.x;
      const Float y = lanes.load(memory_.y, k, of) - s_k.y;
      const Float z = lanes.load(memory_.z, k, of) - s_k.z;
      const Float squared = x * x + (y * y + z * z);
      const auto joins = lanes.both(
          lanes.both(lanes.before(k, of), lanes.atMost(squared, lanes.all(radius * radius))),
          lanes.atMost(lanes.all(M), lanes.load(memory_.similarity, k, of)));
      if (!lanes.any(joins)) continue;
      lanes.mark(joins, marks, k);
      const Float distance = lanes.squareRoot(squared);
      const auto has_none = lanes.atMost(distance, lanes.all(0.0F));
      const Float weight = lanes.where(
          joins, lanes.choose(has_none, lanes.all(0.0F), lanes.load(memory_.weight, k, of)));
      const Float scaled = weight / lanes.choose(has_none, lanes.all(1.0F), distance);
      sum_x += scaled * x;
      sum_y += scaled * y;
      sum_z += scaled * z;
      total += weight;
    }
    const Place sum{lanes.total(sum_x), lanes.total(sum_y), lanes.total(sum_z)};
    const float weights = lanes.total(total);
    if (!(weights > 0.0F)) return {0.0F, 0.0F, 0.0F};
    return {sum.x / weights, sum.y / weights, sum.z / weights};
  }
};

}  // namespace field_phenotyping
