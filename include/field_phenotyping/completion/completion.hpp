#pragma once

#include <memory>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// Third stage: fills the gaps in every owned stem by radial basis functions on the unrolled stem
/// surface (paper 2.5, Eq 17-26). Measured points are not touched; a stem that cannot carry a
/// surface is left as it is, and its flags say why. Thread-safe; deterministic.
/// @param previous an older revision of the block as completed in this process, or null: of plants
///        with the same id only the regions that newer scans touch are solved again (2.6.1)
/// @param device what the coarse models are fitted and the regions' surfaces and filters found on;
///        all else is the CPU's
CompletedBlock completeBlock(std::shared_ptr<const SegmentedBlock> segmented,
                             const CompletionParameters& parameters,
                             const CompletedBlock* previous = nullptr,
                             const ComputeDevice& device = {});

}  // namespace field_phenotyping
