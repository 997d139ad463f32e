#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Gives the organ that carries on each stem's axis beyond its end to that stem's plant: the spike
/// of a tassel, or the innermost leaves of a whorl. It is followed upwards from the end, turning
/// as it turns, and over gaps behind which it goes on.
///
/// Pure function. All lengths in metres, in the local frame of the block's cloud.
///
/// @param axes  stem axis of each plant; a plant that owns no point gets none
/// @param noise standard deviation of the points across a surface
/// @param owner per point of `block.cloud`: index of the plant whose stem holds it, or -1; filled
/// in
void followStemsUp(const Block& block, const std::vector<StemAxis>& axes, float noise,
                   std::vector<std::int32_t>& owner);

}  // namespace field_phenotyping
