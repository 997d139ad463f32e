#pragma once

#include <cstdint>

#include "field_phenotyping/preprocessing/voxel_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// Voxels in the order of their first points.
struct GpuVoxels {
  const VoxelMean* voxels;
  const std::uint64_t* keys;
  std::uint32_t count;
};

/// The voxels of `count` points, given as x y z x y z ..., as inserting one after the other makes
/// them. All must have a key. The result is the stream's and holds until it is given back.
/// @throws GpuError
GpuVoxels voxelsOnGpu(GpuStream& stream, const float* xyz, std::uint32_t count, float voxel_size);

}  // namespace field_phenotyping
