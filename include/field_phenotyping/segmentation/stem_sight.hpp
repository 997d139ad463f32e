#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// What is seen of a stem in one band along it.
struct BandSight {
  float inside = 0.0F;  ///< points in the stem's skin
  float around = 0.0F;  ///< points in the ring of the skin's width round it: leaves'
};

/// Counts the points round the band of that height [m] whose middle is at arc length `middle` [m].
/// @param grid over `points`, in the frame of the midline
BandSight seeBand(const std::vector<Eigen::Vector3f>& points, const NeighborGrid& grid,
                  const Midline& midline, float middle, float height);

}  // namespace field_phenotyping
