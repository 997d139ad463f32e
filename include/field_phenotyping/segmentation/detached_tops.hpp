#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/isolated_points.hpp"

namespace field_phenotyping {

/// Gives to other plants what stands above a plant without being joined to it: a branch of a taller
/// neighbour's tassel, or the end of its leaf, that happens to hang over a short plant.
///
/// A plant is of one piece. Where nothing of it is seen for a stretch in which, by how densely the
/// 15 cm below are seen, many of its points were to be expected, what is above is another plant's,
/// if points of one are far nearer to it than the plant's own: the one that most of it is nearest
/// to, or no plant's where that would raise that one as far. Where plants of the stand usually have
/// long stretches of which nothing is seen, it must be longer than those, and where tops above such
/// a stretch have often no other plant near, nothing is given. A plant's stem stays its own, but
/// for a few points that have followed the neighbour's.
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
