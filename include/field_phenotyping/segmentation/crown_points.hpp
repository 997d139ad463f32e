#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Gives what stands right above a stem, and is no plant's yet, to that stem's plant. The points of
/// a tassel that is hardly seen lie so far apart that nothing leads from one to the next; but a
/// tassel stands on its stem's line, and hardly anything else does up there.
///
/// @param axes  one a plant; the upper half shows where a stem points
/// @param owner per point of `block.cloud`: index of its plant, or -1; filled in
/// Pure function; lengths in metres.
void giveCrownPoints(const Block& block, const std::vector<StemAxis>& axes,
                     std::vector<std::int32_t>& owner);

}  // namespace field_phenotyping
