#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/region_growth.hpp"

namespace field_phenotyping {

/// How good a segmented region is; each in [0, 1].
struct RegionQuality {
  float geometric = 0.0F;   ///< Q_g of Eq 7: how even curvature and density are
  float structural = 0.0F;  ///< Q_s of Eq 8: how few outliers there are, how near its axis it lies
  float overall = 0.0F;     ///< Q of Eq 9
};

/// How alike the values of a region are (one term of Eq 7), in [0, 1]: their differences from the
/// region's mean, and of each from the mean of its neighbours, both in units of the region's mean.
/// 1 for equal values; 0 for none.
float consistency(const std::vector<float>& values, const std::vector<float>& neighbor_means);

/// Points that crowd round a stem without being its own: within twice its skin. Thread-safe.
std::size_t countCrowd(const GrowthScene& scene, const Midline& midline);

/// Evaluates a stem (paper Eq 7-9). Distances d_j of Eq 8 are taken from the stem's own surface
/// about its axis, so that long stems do not score less. Outliers are the points that were removed
/// again, and those that crowd round the stem: what grows along a leaf, or where nothing can be
/// told apart, shows it there.
/// @param grown number of points that growth gave, before merging and pruning
/// @param kept  indices of those that are left
/// @param crowd of countCrowd()
/// Thread-safe.
RegionQuality evaluateRegion(const GrowthScene& scene, std::size_t grown,
                             const std::vector<std::uint32_t>& kept, const Midline& midline,
                             std::size_t crowd);

}  // namespace field_phenotyping
