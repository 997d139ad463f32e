#pragma once

#include <cstdint>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Height of one plant [m]; NaN without points.
struct PlantHeight {
  Trait height;
  std::uint32_t flags = kOk;
};

/// Vertical distance from the soil at the plant's base to the plant's top (paper 2.7). The beams
/// miss the very tip: the mean spacing in height of the highest points is added, and enters the
/// standard deviation beside that of the soil. Without soil in the block the height is that above
/// the lowest point of the plant, its standard deviation that of the sampling only. In mode
/// "paper": the highest point, nothing added. Thread-safe; deterministic.
PlantHeight measurePlantHeight(const SegmentedBlock& block, const Plant& plant,
                               const MeasurementParameters& parameters);

}  // namespace field_phenotyping
