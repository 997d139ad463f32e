#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

// Terms of a region's quality (paper Eq 7-9), on the CPU and on the GPU, with the same bits.

namespace field_phenotyping {

/// How good a segmented region is; each in [0, 1].
struct RegionQuality {
  float geometric = 0.0F;   ///< Q_g of Eq 7: how even curvature and density are
  float structural = 0.0F;  ///< Q_s of Eq 8: how few outliers there are, how near its axis it lies
  float overall = 0.0F;     ///< Q of Eq 9
};

namespace quality {

constexpr float kLambda = 0.5F;  // lambda of both sums of Eq 7

/// What a value adds to the sum of a term of Eq 7: its difference from the region's mean, and from
/// the mean of its neighbours, both in units of the region's mean.
/// @param mean > 0
FIELD_PHENOTYPING_HD inline float consistencyTerm(float value, float neighbor_mean, float mean) {
  constexpr float kBeta = 2.0F;
  const float off = value - mean;
  const float apart = value - neighbor_mean;
  const float off_mean = (off < 0.0F ? -off : off) / mean;
  const float off_neighbors = (apart < 0.0F ? -apart : apart) / mean;
  return 1.0F / (1.0F + off_mean) +
         kLambda * static_cast<float>(exponential(static_cast<double>(-kBeta * off_neighbors)));
}

/// How alike the values of a region are (one term of Eq 7), in [0, 1]. 1 for equal values.
/// @param sum of consistencyTerm() over them
FIELD_PHENOTYPING_HD inline float consistency(float mean, float sum, int count) {
  if (!(mean > 0.0F)) return 1.0F;
  return sum / static_cast<float>(count) / (1.0F + kLambda);
}

/// Mean of the neighbours of the k-th value, in their order, on either side; itself where there are
/// none.
/// @param valueAt valueAt(k)
template <class ValueAt>
FIELD_PHENOTYPING_HD float neighborMean(int k, int count, const ValueAt& valueAt) {
  constexpr int kNeighbors = 4;  // on either side
  const int first = k < kNeighbors ? 0 : k - kNeighbors;
  const int last = count - 1 - k < kNeighbors ? count - 1 : k + kNeighbors;
  const float own = valueAt(k);
  if (last == first) return own;
  float sum = -own;
  for (int j = first; j <= last; ++j) sum += valueAt(j);
  return sum / static_cast<float>(last - first);
}

/// Q of Eq 9, and what it is made of. Distances d_j of Eq 8 are taken from the stem's own surface
/// about its axis, so that long stems do not score less. Outliers are the points that were removed
/// again, and those that crowd round the stem: what grows along a leaf, or where nothing can be
/// told apart, shows it there.
/// @param curvature, density consistency of the region's
/// @param distances, farthest from the surface: their sum and the largest [m]
/// @param grown number of points that growth gave, before merging and pruning; > 0
/// @param kept  of those that are left; > 0
/// @param crowd that crowd round the stem
FIELD_PHENOTYPING_HD inline RegionQuality qualityOf(float curvature, float density, float distances,
                                                    float farthest, int grown, int kept,
                                                    int crowd) {
  constexpr float kCurvature = 0.5F;  // w1, w2 of Eq 7
  constexpr float kDensity = 0.5F;
  constexpr float kOutliers = 0.5F;  // w3, w4 of Eq 8
  constexpr float kDistance = 0.5F;
  constexpr float kGeometric = 0.2F;  // the weights of Eq 9
  constexpr float kStructural = 0.8F;
  RegionQuality quality;
  quality.geometric = kCurvature * curvature + kDensity * density;
  const auto count = static_cast<float>(kept);
  const float near_axis = farthest > 0.0F ? 1.0F - distances / count / farthest : 1.0F;
  quality.structural =
      kOutliers * count / static_cast<float>(grown + crowd) + kDistance * near_axis;
  quality.overall = kGeometric * quality.geometric + kStructural * quality.structural;
  return quality;
}

}  // namespace quality
}  // namespace field_phenotyping
