#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {

/// Start points s_0 ... s_n up one stem (paper 2.4.1, Step 1), found without help: the places where
/// points form an upright line, slab by slab, followed upwards through gaps.
struct StemSeeds {
  std::vector<Eigen::Vector3f> points;  ///< from low to high, local frame [m]; at least two
  float score = 0.0F;  ///< stem evidence: about the number of slabs that show the stem
};

/// Finds the stems of a block. Leaves at stem height, weeds and gaps are survived because evidence
/// must persist vertically: a stem is the best-supported chain of upright clusters over the slabs.
/// Ordered by x, then y, of the lowest seed.
/// @param grid   over the points of `block.cloud`
/// @param shapes local shape of every point of `block.cloud`
std::vector<StemSeeds> findStemSeeds(const Block& block, const NeighborGrid& grid,
                                     const std::vector<LocalShape>& shapes,
                                     const SegmentationParameters& parameters);

}  // namespace field_phenotyping
