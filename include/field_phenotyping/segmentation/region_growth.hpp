#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// The cloud as growth sees it. Holds references; the arrays must outlive it.
struct GrowthScene {
  const std::vector<Eigen::Vector3f>& points;  ///< local frame [m]
  const std::vector<LocalShape>& shapes;       ///< of each point
  const NeighborGrid& grid;                    ///< over the points
};

/// What the growth of one region gave.
struct GrowthRegion {
  std::vector<std::uint32_t> points;  ///< that joined, ascending
  std::uint32_t steps = 0U;
};

/// How alike point `i` is to the stem that `midline` describes, in [0, 1]: distance to the stem's
/// surface, normal across the axis, upright shape. Compared with M.
float similarity(const GrowthScene& scene, std::uint32_t i, const Midline& midline);

/// Grows one constrained region from `start` towards `end` (paper 2.4.1, Step 2, Eq 1-5): a sphere
/// of radius r1 walks up the stem; points inside that are similar to it by M or more join. Stops
/// past `end` or after max_growth_steps. Thread-safe.
GrowthRegion growRegion(const GrowthScene& scene, const Eigen::Vector3f& start,
                        const Eigen::Vector3f& end, const Midline& midline,
                        const SegmentationParameters& parameters);

}  // namespace field_phenotyping
