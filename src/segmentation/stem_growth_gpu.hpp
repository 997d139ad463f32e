#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/growth_task.hpp"

namespace field_phenotyping {

class GpuStream;

/// What has grown; the pointers are the stream's and hold until it is given back.
struct GpuGrowth {
  const growth::Outcome* outcomes;      ///< of each stem
  const growth::RegionResult* regions;  ///< of all stems, one after the other
  const std::uint32_t* points;  ///< members kept, those of a stem from where its members begin
};

/// StemGrowth::growStem() of all stems at once, a thread block each. @throws GpuError
/// @param tasks at least one; their arrays are the host's
GpuGrowth growStemsOnGpu(GpuStream& stream, const std::vector<GrowthTask>& tasks);

}  // namespace field_phenotyping
