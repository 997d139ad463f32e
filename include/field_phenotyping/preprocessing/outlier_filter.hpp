#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping {

/// Marks isolated points: 1 keeps, 0 drops a point with fewer than `min_neighbors` others within
/// `radius` [m]. The radius doubles until the typical point has twice that many, so that a sparse
/// cloud is not emptied. The same on every device.
std::vector<std::uint8_t> radiusOutlierFilter(const PointCloud& cloud, float radius,
                                              int min_neighbors, const ComputeDevice& device = {});

}  // namespace field_phenotyping
