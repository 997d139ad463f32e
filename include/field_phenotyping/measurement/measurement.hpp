#pragma once

#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// Last stage: the traits of every owned plant of a block, ordered as in the block
/// (paper 2.7, 2.8). Only measured points are used. Cross-sections are fitted on the device; the
/// results do not depend on it. Thread-safe; deterministic.
std::vector<Phenotype> measureBlock(const CompletedBlock& block,
                                    const MeasurementParameters& parameters,
                                    const ComputeDevice& device = {});

}  // namespace field_phenotyping
