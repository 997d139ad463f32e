#pragma once

#include <optional>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"

namespace field_phenotyping {

/// Axis of a stem whose foot the canopy hides, carried down to the soil anew.
///
/// Where only the top of a stem is seen well, leaves turn the midline by a few degrees, and its
/// foot ends up at a neighbour's. So the foot is chosen among the places round it: it should give
/// the stem a lean that the stand has, agree with the slope of what is seen, and meet the few
/// points that are seen further down. Straight from there to the middle of the part that is seen.
///
/// @param grid over the points of `block.cloud`
/// @param lean of the stand
/// None where the foot is seen, or where the stand's lean is not known: the axis is good as it is.
/// Thread-safe; deterministic.
std::optional<StemAxis> settleFoot(const Block& block, const NeighborGrid& grid,
                                   const Midline& midline, const StandLean& lean);

}  // namespace field_phenotyping
