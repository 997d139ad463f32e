#pragma once

#include <cmath>

#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/team_order.hpp"
#include "field_phenotyping/segmentation/axis_view.hpp"
#include "field_phenotyping/segmentation/growth_task.hpp"

// Dynamic region merging (paper 2.4.1, Step 3) by one member of a team. Regions are of one stem,
// from the base up; only those that follow one another along its axis are compared. On the CPU and
// on the GPU, with the same bits; thread-safe.

namespace field_phenotyping {

FIELD_PHENOTYPING_HD inline float lengthOf(const Place& vector) {
  return std::sqrt(dotOf(vector, vector));
}
/// Of length 1; itself where it has none.
FIELD_PHENOTYPING_HD inline Place unitOf(const Place& vector) {
  const float length = lengthOf(vector);
  if (!(length > 0.0F)) return vector;
  return {vector.x / length, vector.y / length, vector.z / length};
}

/// Sets where a region lies along its own line.
/// @param count   of its points, > 0
/// @param extents sums of their x, y and z; least and most that they lie along the line [m]
FIELD_PHENOTYPING_HD inline void setExtent(const GrowthRegionTask& task, int count,
                                           const double* extents, growth::Region& region) {
  const Place along = unitOf(differenceOf(task.end, task.start));
  region.centroid = {static_cast<float>(extents[0] / count), static_cast<float>(extents[1] / count),
                     static_cast<float>(extents[2] / count)};
  const float middle = dotOf(along, region.centroid);
  const float low = static_cast<float>(extents[3]) - middle;
  const float high = static_cast<float>(extents[4]) - middle;
  region.lower_end = movedAlong(region.centroid, low < 0.0F ? low : 0.0F, along);
  region.upper_end = movedAlong(region.centroid, high > 0.0F ? high : 0.0F, along);
}

/// d(R_low, R_high) of Eq 6 [m]: 0.3 of the centroids' distance beyond that of regions of their
/// lengths that touch, 0.3 of the distance between the ends that face each other, 0.4 of the
/// smallest distance between their points. For regions on one straight axis it is the gap between
/// them; a region that lies off the axis is farther.
/// @param low, high with points; their extents are set
/// @param from, to  where the lower one starts and the higher one ends
/// @param apart     smallest distance between their points [m]
FIELD_PHENOTYPING_HD inline float regionDistance(const growth::Region& low,
                                                 const growth::Region& high, const Place& from,
                                                 const Place& to, float apart) {
  const float centroids = lengthOf(differenceOf(high.centroid, low.centroid));
  const float touching = lengthOf(differenceOf(low.upper_end, low.centroid)) +
                         lengthOf(differenceOf(high.centroid, high.lower_end));
  // Regions that overlap are not apart at their ends, however far one reaches into the other.
  const Place along = unitOf(differenceOf(to, from));
  const Place ends = differenceOf(high.lower_end, low.upper_end);
  const float between = dotOf(along, ends);
  const float overlap = between < 0.0F ? between : 0.0F;
  constexpr float kCentroids = 0.3F;  // w1, w2, w3 of Eq 6
  constexpr float kEnds = 0.3F;
  constexpr float kPoints = 0.4F;
  const float beyond = centroids - touching;
  return kCentroids * (beyond > 0.0F ? beyond : 0.0F) +
         kEnds * lengthOf(movedAlong(ends, -overlap, along)) + kPoints * apart;
}

/// tau_0 [m]: the 87.5th percentile of the distances, at least `least` and at most `most` [m].
/// @param distances left in another order
FIELD_PHENOTYPING_HD inline float initialMergingThreshold(double* distances, int count, float least,
                                                          float most) {
  if (count == 0) return least;
  constexpr double kPercentile = 0.875;
  const int rank = static_cast<int>(std::floor(kPercentile * (count - 1) + 0.5));
  const auto chosen = static_cast<float>(selectAlone(distances, count, rank));
  const float bounded = chosen < most ? chosen : most;
  return bounded > least ? bounded : least;
}

/// tau_(t+1) of Eq 10 [m] with f(Q, T) = tau clip(Q / T, 0.5, 1.5).
FIELD_PHENOTYPING_HD inline float adaptMergingThreshold(float threshold, float quality,
                                                        float target) {
  constexpr float kEta = 0.3F;
  constexpr float kLeast = 0.5F;
  constexpr float kMost = 1.5F;
  const float ratio = target > 0.0F ? growth::within(quality / target, kLeast, kMost) : kMost;
  return (1.0F - kEta) * threshold + kEta * threshold * ratio;
}

/// Whether a region goes on from those below for what the surface that was completed there expects
/// (2.6.1), however far their distance says that it is.
FIELD_PHENOTYPING_HD inline bool isCarriedTo(const growth::Region& region,
                                             const GrowthRegionTask& task) {
  constexpr float kDoubt = -1.0F;  // points may speak against it by so much: the midline, which was
                                   // found from all of the stem, speaks for it
  return region.distance <= task.longest_carried && region.evidence > kDoubt;
}

/// Merges regions nearer than `threshold` [m], or that the surface carries to, and sets which of
/// them belong to the merged region with the most points.
FIELD_PHENOTYPING_HD inline void mergeRegions(growth::Region* regions,
                                              const GrowthRegionTask* tasks, int count,
                                              float threshold) {
  int most = 0;
  int begin = 0;  // of the merged region with the most points
  int end = 0;
  int first = 0;  // of the one that is being merged
  int points = 0;
  bool is_lowest = true;
  for (int r = 0; r <= count; ++r) {
    const bool is_end = r == count;
    if (!is_end && regions[r].count == 0) continue;
    const bool goes_on = !is_end && !is_lowest &&
                         (regions[r].distance < threshold || isCarriedTo(regions[r], tasks[r]));
    if (!goes_on) {
      if (points > most) {
        most = points;
        begin = first;
        end = r;
      }
      first = r;
      points = 0;
    }
    if (!is_end) points += regions[r].count;
    is_lowest = false;
  }
  for (int r = 0; r < count; ++r) {
    regions[r].merged = r >= begin && r < end && regions[r].count > 0;
  }
}

}  // namespace field_phenotyping
