#pragma once

#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/sampling_profile.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"

namespace field_phenotyping {

/// Fits the stems of a stand once they are found: where their surfaces are and where they end, each
/// of which shows the other, and of which the stems tell one another. Stems far thicker than the
/// stand's are looked for within what wraps them. Seedlings are fitted anew, and two that come to
/// one stem are one.
/// @param plant_height about how high the plants are [m]
/// @param sampling     of the block; not asked where there are few stems
/// @param device       what leaf bases are searched for on; all else is the CPU's
/// Thread-safe; deterministic.
std::vector<GrownStem> fitStand(const GrowthScene& scene, const StemSelection& selection,
                                float plant_height, const SamplingProfile& sampling,
                                std::vector<GrownStem> stems,
                                const SegmentationParameters& parameters,
                                const ComputeDevice& device = {});

}  // namespace field_phenotyping
