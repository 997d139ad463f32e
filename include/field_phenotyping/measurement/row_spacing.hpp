#pragma once

#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Where a plant stands among the others, horizontally [m].
struct PlantSpacing {
  Trait in_row;  ///< to the next plant in its row
  Trait to_row;  ///< to the nearest neighbouring row, across the rows
};

/// Distances of each plant of the block, one entry per plant.
///
/// The row direction is the one that most nearest neighbours agree on, within a half turn; "next"
/// is towards its positive x (positive y for rows along y). The next plant lies within 30 degrees
/// of the row direction. NaN for the last plant of a row, and for all where no direction prevails
/// or fewer than three plants are known. A neighbouring row is the nearest plants beside a plant,
/// more across the rows from it than along them, on either side; NaN where there is none. Plants of
/// the margin count as neighbours. Thread-safe.
std::vector<PlantSpacing> measureRowSpacing(const SegmentedBlock& block);

}  // namespace field_phenotyping
