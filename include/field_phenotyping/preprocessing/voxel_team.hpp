#pragma once

#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// What a voxel makes of its points, on the CPU and on the GPU: each thread takes whole voxels.

/// Voxels on either side of a tile's origin, along each axis.
constexpr float kVoxelHalfRange = 1048576.0F;  // 2^20

/// Number of the voxel along one axis, from 0, of a coordinate that lies within the half range.
/// Rounded down by hand, which compilers can do for several at once.
FIELD_PHENOTYPING_HD inline std::int32_t voxelOnAxis(float coordinate, float voxel_size) {
  const float at = coordinate / voxel_size;
  const auto whole = static_cast<std::int32_t>(at);
  return whole - (static_cast<float>(whole) > at ? 1 : 0) +
         static_cast<std::int32_t>(kVoxelHalfRange);
}

/// 21 bits an axis, of what voxelOnAxis() gives for each.
FIELD_PHENOTYPING_HD inline std::uint64_t voxelKeyOf(std::int32_t x, std::int32_t y,
                                                     std::int32_t z) {
  return static_cast<std::uint64_t>(x) << 42U | static_cast<std::uint64_t>(y) << 21U |
         static_cast<std::uint64_t>(z);
}

FIELD_PHENOTYPING_HD inline std::uint64_t voxelKeyOf(const Place& p, float voxel_size) {
  return voxelKeyOf(voxelOnAxis(p.x, voxel_size), voxelOnAxis(p.y, voxel_size),
                    voxelOnAxis(p.z, voxel_size));
}

/// The centroid of the points that a voxel has got so far [m].
struct VoxelMean {
  Place mean = {0.0F, 0.0F, 0.0F};
  std::uint32_t count = 0U;

  /// What add() makes of the first point: a zero has no sign.
  FIELD_PHENOTYPING_HD static VoxelMean of(const Place& p) {
    return {{0.0F + p.x, 0.0F + p.y, 0.0F + p.z}, 1U};
  }

  /// A running mean: sums lose precision where the rover stands still for long.
  FIELD_PHENOTYPING_HD void add(const Place& p) {
    ++count;
    const auto n = static_cast<float>(count);
    mean.x += (p.x - mean.x) / n;
    mean.y += (p.y - mean.y) / n;
    mean.z += (p.z - mean.z) / n;
  }
};

/// A voxel of points that were sorted by voxel and, within one, by when they came.
/// @param points as they came
/// @param order number of each sorted point among them
FIELD_PHENOTYPING_HD inline VoxelMean meanOfSorted(const Place* points, const std::uint32_t* order,
                                                   std::uint32_t begin, std::uint32_t end) {
  VoxelMean voxel;
  for (std::uint32_t k = begin; k < end; ++k) voxel.add(points[order[k]]);
  return voxel;
}

}  // namespace field_phenotyping
