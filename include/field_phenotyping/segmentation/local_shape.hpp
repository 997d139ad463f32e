#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {

/// Shape of the cloud round one point, from the principal components of its neighbourhood.
struct LocalShape {
  Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();  ///< of largest extent, unit, z >= 0
  Eigen::Vector3f normal = Eigen::Vector3f::UnitX();     ///< of least extent, unit, sign arbitrary
  float linearity = 0.0F;        ///< (l1 - l2) / l1 in [0, 1]: 1 for a thin line
  float curvature = 0.0F;        ///< l3 / (l1 + l2 + l3), the surface variation, in [0, 1/3]
  std::uint32_t neighbors = 0U;  ///< points within the radius, itself included
};

/// Local shape of the cloud within `radius` [m] of `point`; neutral where fewer than five points
/// are found.
/// @param grid over the cloud
LocalShape computeLocalShape(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius);

/// Local shapes of `points` within `radius` [m]; neutral where fewer than five neighbours are
/// found. The same bit for bit on every device.
/// @param grid over the same points
std::vector<LocalShape> computeLocalShapes(const std::vector<Eigen::Vector3f>& points,
                                           const NeighborGrid& grid, float radius,
                                           const ComputeDevice& device = {});

}  // namespace field_phenotyping
