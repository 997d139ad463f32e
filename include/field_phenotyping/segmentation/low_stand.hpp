#pragma once

#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_search.hpp"

namespace field_phenotyping {

/// The parameters of the search for stems in a stand of that height: those of seedlings are looked
/// for from nearer to the soil, where their leaves begin, and by pieces and slabs that are shorter
/// in proportion to the plants.
/// @param plant_height about how high the plants are [m]
SegmentationParameters adaptToHeight(float plant_height, SegmentationParameters parameters);

/// As findStems(), in stands of any height. Seedlings stand where their leaves come together
/// (findLeafConvergences()), whether a stem was found there or not; they come with the most leaves
/// first. Short pieces of stem do not tell a plant from a weed as high; many do: plants stand
/// upright and in rows, and in stands so low only those in the rows count. Where many show no rows
/// all are weeds; of a few those count that show as much of themselves as tall plants must.
/// Thread-safe; deterministic.
std::vector<GrownStem> findStandingStems(const GrowthScene& scene, const Block& block,
                                         const StemSelection& selection, float plant_height,
                                         const SegmentationParameters& parameters);

}  // namespace field_phenotyping
