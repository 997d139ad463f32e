#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Finds the lowest points of stems among the soil that was taken out beside them, `block.feet`.
///
/// By height alone the lowest centimetres of a stem cannot be told from soil. Once its surface is
/// known they can: a point is the stem's where that explains it better than the soil does, the
/// stem with as many points to a centimetre, as near to its surface, as just above; the soil as
/// dense, as high and as rough as round the foot.
///
/// @param axes       one a stem
/// @param stem_owner index of the stem of each point of `block.cloud`, -1: none
/// @return the same of each point of `block.feet`
/// Stems with few points just above the soil get none. Thread-safe; deterministic.
std::vector<std::int32_t> findFootPoints(const Block& block, const std::vector<StemAxis>& axes,
                                         const std::vector<std::int32_t>& stem_owner);

}  // namespace field_phenotyping
