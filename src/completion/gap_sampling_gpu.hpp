#pragma once

#include <vector>

#include "field_phenotyping/completion/gap_sampling_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// Points that fill the gaps of all tasks; the pointers are the stream's and hold until it is given
/// back.
struct GpuGapSamples {
  const GapTotals* totals;        ///< of each task
  const SurfacePosition* places;  ///< GapTotals::samples of the first task, then of the next ...
};

/// GapFinder and spreadOverGaps() of all tasks at once, a thread block each. @throws GpuError
/// @param tasks at least one, with cells; their arrays are the host's
GpuGapSamples gapSamplesOnGpu(GpuStream& stream, const std::vector<GapTask>& tasks);

}  // namespace field_phenotyping
