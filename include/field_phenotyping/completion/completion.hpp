#pragma once

#include <memory>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// Third stage: fills the gaps in every owned stem by radial basis functions on the unrolled stem
/// surface (paper 2.5, Eq 17-24). Measured points are not touched; a stem that cannot carry a
/// surface is left as it is. Thread-safe; deterministic.
CompletedBlock completeBlock(std::shared_ptr<const SegmentedBlock> segmented,
                             const CompletionParameters& parameters);

}  // namespace field_phenotyping
