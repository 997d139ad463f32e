#pragma once

#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"

namespace field_phenotyping {

constexpr float kStemSurroundings = 2.5F;  ///< max_stem_radius: points this near may tell of a stem
constexpr float kBeyondEnd = 0.2F;  ///< of a plant's height, that a stem may go on above its end

/// Finds the stems of a block (paper 2.4.1, Step 1, start points without hands): candidates grow
/// from start points, those that are stems are kept, and what these show of the stand (lean, rows)
/// helps to find more, and to carry those down whose feet are hidden. In order of x, then y.
/// @param plant_height about how high the block's plants are [m]
/// Thread-safe; deterministic.
std::vector<GrownStem> findStems(const GrowthScene& scene, const Block& block,
                                 const StemSelection& selection, float plant_height,
                                 const SegmentationParameters& parameters);

/// What grows along an axis that is about known, and ends somewhere along it; nothing may grow
/// where a stem shows no points. Thread-safe; deterministic.
/// @param hidden of the axis from its base, as in Midline [m]
GrownStem growAlong(const GrowthScene& scene, const StemAxis& axis, float hidden,
                    float plant_height, const SegmentationParameters& parameters);

/// Leaves out start points high up, where some stems of the stand were found and their feet are
/// seen, and where the canopy lets what is below be seen: a stem would show there.
/// @param stand        stems that were found
/// @param plant_height about how high the plants are [m]
std::vector<StemSeeds> withoutFloating(std::vector<StemSeeds> seeds,
                                       const std::vector<GrownStem>& stand,
                                       const GroundModel& ground, const Canopy& canopy,
                                       float plant_height);

/// Those of the candidates that are stems.
std::vector<GrownStem> onlyStems(const StemSelection& selection, std::vector<GrownStem> grown);

std::vector<StemAxis> axesOf(const std::vector<GrownStem>& stems);

}  // namespace field_phenotyping
