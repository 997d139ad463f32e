#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/isolated_points.hpp"

namespace field_phenotyping {

/// Gives to other plants what stands above a plant without being joined to it: a branch of a taller
/// neighbour's tassel, or the end of its leaf, that happens to hang over a short plant or beside
/// it.
///
/// A plant is of one piece. From its highest point a way leads down to the rest of it, from point
/// to point; the longest step that no way can do without is a gap (the highest edge on the path in
/// the minimum spanning tree of its points). Where that is longer than plants of the stand usually
/// have, what is above is another plant's, if points of one are far nearer to it than the plant's
/// own: the one that most of it is nearest to, or no plant's where that would raise that one as
/// far. What is highest then is looked at likewise. A plant's stem stays its own, but for a few
/// points that have followed the neighbour's.
///
/// Nothing is given where gaps of some centimetres are usual, for tops that are badly seen, nor
/// above gaps that as many tops have with no other plant near, as far as one is near to tops by
/// chance.
///
/// @param grid        over the points of `block.cloud`
/// @param plants      how many there are
/// @param owners      of the points of `block.cloud`; changed
/// @param isolated    of the points of `block.isolated`; changed
/// @return standard deviation of each plant's highest point [m] by what it lost or got: at least
/// one
///         in ten of such tops is given away wrongly
/// Pure function; deterministic; plants are worked side by side.
std::vector<float> giveDetachedTops(const Block& block, const NeighborGrid& grid,
                                    std::size_t plants, PointOwners& owners, PointOwners& isolated);

}  // namespace field_phenotyping
