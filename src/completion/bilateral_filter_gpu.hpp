#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/completion/bilateral_filter_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// Nodes of all filters; the pointers are the stream's and hold until it is given back.
struct GpuFilters {
  std::vector<std::size_t> begins;  ///< where those of each filter begin
  const FilterNode* nodes;
  const FilterColor* colors;  ///< of those by colour; null where there is none
};

/// FilterSolver of all tasks at once, a thread block each. @throws GpuError
/// @param tasks at least one; their arrays are the host's
GpuFilters filtersOnGpu(GpuStream& stream, const std::vector<FilterTask>& tasks);

}  // namespace field_phenotyping
