#pragma once

#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Distance of each plant of the block to the next one in its row [m], one per plant, horizontally.
///
/// The row direction is the one that most nearest neighbours agree on, within a half turn; "next"
/// is towards its positive x (positive y for rows along y). The next plant lies within 30 degrees
/// of the row direction. NaN for the last plant of a row, and for all where no direction prevails
/// or fewer than three plants are known. Plants of the margin count as neighbours. Thread-safe.
std::vector<Trait> measureRowSpacing(const SegmentedBlock& block);

}  // namespace field_phenotyping
