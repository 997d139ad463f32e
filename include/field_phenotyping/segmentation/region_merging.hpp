#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/segmentation/region_growth.hpp"

namespace field_phenotyping {

// Dynamic region merging (paper 2.4.1, Step 3). Regions are of one stem, from the base up; only
// those that follow one another along its axis are compared. Thread-safe, all of it.

/// d(R_low, R_high) of Eq 6 [m]: 0.3 of the centroids' distance beyond that of regions of their
/// lengths that touch, 0.3 of the distance between the ends that face each other, 0.4 of the
/// smallest distance between their points. For regions on one straight axis it is the gap between
/// them; a region that lies off the axis is farther.
/// Infinite where either is empty.
float regionDistance(const std::vector<Eigen::Vector3f>& points, const GrowthRegion& low,
                     const GrowthRegion& high);

/// Distances of every region with points from the next one above that has points [m].
std::vector<float> neighborDistances(const std::vector<Eigen::Vector3f>& points,
                                     const std::vector<GrowthRegion>& regions);

/// tau_0 [m]: the 87.5th percentile of the distances, at least `least` and at most `most` [m].
float initialMergingThreshold(std::vector<float> distances, float least, float most);

/// tau_(t+1) of Eq 10 [m] with f(Q, T) = tau clip(Q / T, 0.5, 1.5).
float adaptMergingThreshold(float threshold, float quality, float target);

/// Merges regions nearer than `threshold` [m]; gives back which of them belong to the merged region
/// with the most points.
/// @param distances neighborDistances() of the same regions
std::vector<std::uint8_t> mergeRegions(const std::vector<GrowthRegion>& regions,
                                       const std::vector<float>& distances, float threshold);

}  // namespace field_phenotyping
