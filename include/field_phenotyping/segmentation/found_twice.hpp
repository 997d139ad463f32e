#pragma once

#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"

namespace field_phenotyping {

/// Leaves out what was taken for a plant beside the one that it is part of.
///
/// A piece high up a stem makes a candidate of its own where leaves hide what is below it. Its foot
/// is guessed, and what is known of the stand puts that where the plant's own foot is. So of stems
/// that rise from one place only the one that most points show stays, unless both are seen well
/// beside one another at the same height: then they are two, and a guessed foot is wrong.
///
/// @param least_distance [m] of two plants at the soil, `min_plant_spacing`
/// Keeps the order. Thread-safe; deterministic.
std::vector<GrownStem> withoutFoundTwice(const Block& block, std::vector<GrownStem> stems,
                                         float least_distance);

}  // namespace field_phenotyping
