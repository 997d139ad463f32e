#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// A grown stem that may be a leaf, a weed, or a plant that another candidate has found as well.
struct StemCandidate {
  const Midline& midline;  ///< from the soil to the top of the stem
  const std::vector<std::uint32_t>&
      points;  ///< that grew, ascending indices into the block's cloud
};

/// Which candidates are stems; ascending indices.
///
/// Seeds are generous, for only a grown stem shows what it is: one that runs from the soil up
/// without long gaps, with much more evidence for its height than leaves and noise give. How much
/// that is depends on the sensor, so every candidate is measured against the block's best. Of two
/// candidates that share points, or that stand nearer than min_plant_spacing, the better stays.
/// @param grid over the points of `block.cloud`
std::vector<std::size_t> selectStems(const Block& block, const NeighborGrid& grid,
                                     const std::vector<StemCandidate>& candidates,
                                     const SegmentationParameters& parameters);

}  // namespace field_phenotyping
