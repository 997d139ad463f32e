#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/measurement/outermost_heights_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// findOutermostHeights() of all tasks at once, a thread block each. The result, one for each task,
/// is the stream's and holds until it is given back. @throws GpuError
/// @param xyz   of each point
/// @param tasks at least one
const OutermostHeights* outermostHeightsOnGpu(GpuStream& stream, const float* xyz,
                                              std::size_t points,
                                              const std::vector<PlantEndTask>& tasks);

}  // namespace field_phenotyping
