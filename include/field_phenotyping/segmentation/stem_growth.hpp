#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// One stem as it has grown.
struct GrownStem {
  Midline midline;
  std::vector<std::uint32_t> points;  ///< ascending
  GrowthSummary growth;
};

/// Steps 2 and 3 once, with one M, for a candidate that may be no stem: regions grown between the
/// nodes of the midline, what was over-segmented removed (2.4.2). On the CPU, between the steps
/// that look for stems. Thread-safe.
GrownStem growCandidate(const GrowthScene& scene, Midline midline,
                        const SegmentationParameters& parameters);

/// Steps 2 to 4 whole (paper 2.4.1, 2.4.2, 3.1.2): the stem is split at its branchings, every
/// segment grown with an M of its own; regions that follow one another merge, across gaps that the
/// surface completed below them carries across (2.6.1); what was over-segmented goes; while the
/// quality is below `quality_target` the parameters are adapted and the stem is grown again. The
/// best growth is kept.
/// @param max_gap [m] longest gap that regions may merge across for their distance alone, from the
///                plants' spacing
/// Thread-safe; deterministic.
GrownStem growStem(const GrowthScene& scene, const Midline& midline, float max_gap,
                   const SegmentationParameters& parameters);

/// The same of many stems, on all cores or, a thread block each, on the GPU, with the same bits:
/// there growth, merging, pruning, quality and cycles of all of them in one launch. Which points
/// lie round each, how it is split and how many points crowd round it are found on the CPU.
/// @param midlines not null
std::vector<GrownStem> growStems(const GrowthScene& scene,
                                 const std::vector<const Midline*>& midlines, float max_gap,
                                 const SegmentationParameters& parameters,
                                 const ComputeDevice& device = {});

std::vector<const Midline*> midlinesOf(const std::vector<GrownStem>& stems);

}  // namespace field_phenotyping
