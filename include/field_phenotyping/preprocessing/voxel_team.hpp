#pragma once

#include <cmath>
#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// What a voxel makes of its points, on the CPU and on the GPU: each thread takes whole voxels.

/// Voxels on either side of a tile's origin, along each axis.
constexpr float kVoxelHalfRange = 1048576.0F;  // 2^20

/// Number of the voxel along one axis, from 0, of a coordinate that lies within the half range.
FIELD_PHENOTYPING_HD inline std::uint64_t voxelOnAxis(float coordinate, float voxel_size) {
  const float cell = std::floor(coordinate / voxel_size);
  return static_cast<std::uint64_t>(static_cast<std::int64_t>(cell + kVoxelHalfRange));
}

/// 21 bits an axis.
FIELD_PHENOTYPING_HD inline std::uint64_t voxelKeyOf(const Place& p, float voxel_size) {
  return voxelOnAxis(p.x, voxel_size) << 42U | voxelOnAxis(p.y, voxel_size) << 21U |
         voxelOnAxis(p.z, voxel_size);
}

/// The centroid of the points that a voxel has got so far [m].
struct VoxelMean {
  Place mean = {0.0F, 0.0F, 0.0F};
  std::uint32_t count = 0U;

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
