#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Whose each point is: index of the plant, -1: none's.
struct PointOwners {
  std::vector<std::int32_t> stem;   ///< the plant that the point is a stem point of
  std::vector<std::int32_t> plant;  ///< the plant that the point is of, by any organ

  /// The plant that point `i` is of, stem or not.
  std::int32_t of(std::size_t i) const { return stem[i] >= 0 ? stem[i] : plant[i]; }
};

/// Finds what belongs to plants among the points that were taken out as outliers,
/// `block.isolated`.
///
/// In sparse clouds stems and tips of leaves and tassels have points with next to no neighbours.
/// Alone such a point cannot be told from dust; once stems and plants are known it can:
/// - it is a stem's where the stem, with as many points to a centimetre and as near to its surface
///   as those round it, explains the point better than anything else there does;
/// - it is a plant's where that is what it lies next to: 6 to 10 cm off, as far as few of the
///   block's points that are so near to plants can be dust, judged by those that are farther off.
/// Nothing that is found or measured without them changes what they are given to, so dust cannot
/// make a plant.
///
/// @param grid  over the points of `block.cloud`
/// @param axes  one a plant
/// @param known of the points of `block.cloud`
/// @return of the points of `block.isolated`
/// Thread-safe; deterministic.
PointOwners findIsolatedPoints(const Block& block, const NeighborGrid& grid,
                               const std::vector<StemAxis>& axes, const PointOwners& known);

}  // namespace field_phenotyping
