#pragma once

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Second stage: finds the plants of a block and gives every point to a plant or to none
/// (paper 2.4). Plants come ordered by position, with id -1 (see PlantRegistry). An empty block
/// gives no plants. Thread-safe; deterministic, whatever the device.
SegmentedBlock segmentBlock(const Block& block, const SegmentationParameters& parameters,
                            const ComputeDevice& device = {});

}  // namespace field_phenotyping
