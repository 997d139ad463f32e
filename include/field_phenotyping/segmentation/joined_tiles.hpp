#pragma once

#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// What was segmented as one, tile by tile: of each the points and the plants in it and in its
/// margin, as if it had been worked by itself. Frame, soil and `source_index` stay those of the
/// whole, so that nothing is said twice of one point.
/// @param tiles that were joined, Block::joined; none: `block` is of one tile, and comes back as it
/// is
std::vector<SegmentedBlock> splitIntoTiles(SegmentedBlock block,
                                           const std::vector<BlockHeader>& tiles);

}  // namespace field_phenotyping
