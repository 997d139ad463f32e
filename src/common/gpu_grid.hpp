#pragma once

#include <cstddef>
#include <cstdint>

#include "common/gpu_stream.hpp"
#include "field_phenotyping/common/grid_view.hpp"

namespace field_phenotyping {

/// A NeighborGrid in the device's memory: the same points in the same order.
struct GpuGrid {
  GridView view;             ///< of the device's memory
  std::uint32_t cells = 0U;  ///< that hold points
};

/// Sorts points by cell on the GPU. Returns when it is done.
/// @param points in the device's memory
/// @throws GpuError
GpuGrid buildGpuGrid(GpuStream& stream, const Place* points, std::uint32_t count,
                     const GridGeometry& geometry);

}  // namespace field_phenotyping
