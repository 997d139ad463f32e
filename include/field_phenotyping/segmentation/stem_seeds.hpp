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

/// What makes a point a vote for a stem.
enum class SeedEvidence {
  kUpright,  ///< its neighbourhood is a line that stands up
  kDensity,  ///< that it is there: for stems too sparse or too hidden to show a shape
};

/// Finds candidates for the stems of a block. Leaves at stem height, weeds and gaps are survived
/// because evidence must persist vertically: a stem is the best-supported chain of clusters of
/// votes over the slabs. Some candidates are leaves; what grows from them shows it (StemSelection).
/// Best-supported first.
/// @param grid      over the points of `block.cloud`
/// @param shapes    local shape of every point of `block.cloud`
/// @param explained points to leave out, 1 each; empty: none
/// @param most      candidates
std::vector<StemSeeds> findStemSeeds(const Block& block, const NeighborGrid& grid,
                                     const std::vector<LocalShape>& shapes,
                                     const SegmentationParameters& parameters,
                                     SeedEvidence evidence,
                                     const std::vector<std::uint8_t>& explained = {},
                                     std::size_t most = 1000U);

}  // namespace field_phenotyping
