#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {

/// A place where leaves that rise to opposite sides come from.
struct LeafConvergence {
  Eigen::Vector2f place = Eigen::Vector2f::Zero();  ///< local frame [m]
  float votes = 0.0F;  ///< leaves that lead there, each balanced by others across; any unit
};

/// Where the leaves of low plants come together: start points for stems so short that few points or
/// none show them (paper 2.4.1, Step 1), since leaves show them from all about.
///
/// A Hough transform: the tangent of a leaf, followed down and inwards, leads past the stem. Every
/// point with a line for a neighbourhood votes for the places along it, up to where it meets the
/// soil. Of the votes for a place those count that come from one side as well as from the other,
/// for beneath the middle of a leaf all come from one.
///
/// The strongest first; none nearer to a stronger one than `least_distance`.
/// @param shapes         local shape of every point of `block.cloud`
/// @param plant_height   about how high the plants are [m]
/// @param least_distance between plants [m]
/// Thread-safe; deterministic.
std::vector<LeafConvergence> findLeafConvergences(const Block& block,
                                                  const std::vector<LocalShape>& shapes,
                                                  float plant_height, float least_distance);

}  // namespace field_phenotyping
