#pragma once

#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/segmentation/local_shape_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// Local shapes of `count` points, given as x y z x y z ..., within `radius` [m], in their order.
/// The result is the stream's and holds until it is given back.
/// @throws GpuError
const LocalShapeNumbers* localShapesOnGpu(GpuStream& stream, const float* xyz, std::uint32_t count,
                                          const GridGeometry& geometry, float radius);

}  // namespace field_phenotyping
