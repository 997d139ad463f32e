#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// Indices of points in the order of a Z-order (Morton) curve through cubic cells: what lies near
/// in space then lies near in memory, and work that goes from neighbour to neighbour waits for
/// memory far less. Points of one cell stay in their order. Deterministic; thread-safe.
/// @param points finite [m]
std::vector<std::uint32_t> spatialOrder(const std::vector<Eigen::Vector3f>& points);

}  // namespace field_phenotyping
