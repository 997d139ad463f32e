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

/// Points within about `radius` [m] of an axis, its ends included; ascending.
std::vector<std::uint32_t> pointsAround(const GrowthScene& scene, const StemAxis& axis,
                                        float radius);

/// Points within `radius` [m] of an axis that is carried on straight beyond its ends, and perhaps
/// some a little farther off; ascending.
/// @param beyond [m] of either end
std::vector<std::uint32_t> pointsAlong(const GrowthScene& scene, const StemAxis& axis, float radius,
                                       float beyond);

/// Points that crowd round a stem without being its own: within twice its skin. Thread-safe.
std::size_t countCrowd(const GrowthScene& scene, const Midline& midline);

}  // namespace field_phenotyping
