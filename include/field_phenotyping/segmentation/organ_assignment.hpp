#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Gives every other organ to its plant: shortest paths over the cloud from all stems at once,
/// where squared step lengths make a path keep to the organ that it runs along.
///
/// @param owner per point of `block.cloud`: index of the plant whose stem holds it, or -1
/// @return the same array with leaves and tassels filled in; what no stem reaches stays -1
std::vector<std::int32_t> assignOrgans(const Block& block, const std::vector<StemAxis>& axes,
                                       std::vector<std::int32_t> owner,
                                       const SegmentationParameters& parameters);

}  // namespace field_phenotyping
