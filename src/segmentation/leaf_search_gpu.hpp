#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/segmentation/leaf_search_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// What was found; the pointers are the stream's and hold until it is given back.
struct GpuLeafBases {
  std::vector<std::size_t> begins;  ///< where those of each stem begin
  const LeafBase* bases;
  const int* counts;  ///< of each stem
};

/// LeafSearch of all stems at once, a thread block each. @throws GpuError
/// @param tasks at least one; their arrays are the host's
GpuLeafBases leafBasesOnGpu(GpuStream& stream, const std::vector<LeafSearchTask>& tasks);

}  // namespace field_phenotyping
