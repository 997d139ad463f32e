#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"

namespace field_phenotyping {

/// One row of a stand. Metres, map frame.
struct RowSummary {
  std::int32_t row = 0;        ///< numbered across the rows, from 0
  std::uint32_t plants = 0U;   ///< counted
  double plants_stddev = 0.0;  ///< a plant flagged low_confidence is one with a chance of a half
  std::uint32_t gaps = 0U;     ///< spacings more than one and a half times the row's median
  std::uint32_t missing = 0U;  ///< plants that would fill them
  double longest_gap = 0.0;    ///< longest spacing
  double length = 0.0;         ///< first plant to last, along the row
  Trait spacing;               ///< median of the plants' spacings; NaN for fewer than three plants
  Trait row_spacing;           ///< to the next row; NaN for the last one
  Eigen::Vector2d start = Eigen::Vector2d::Zero();  ///< first plant, on the row's line
  Eigen::Vector2d end = Eigen::Vector2d::Zero();    ///< last plant
};

/// The rows of a stand, by the bases of its plants: straight and parallel, as a drill sows them.
/// The direction is the one in which the bases crowd into the narrowest lines; a row ends where the
/// next plant across is more than 15 cm away. Empty for fewer than three plants.
///
/// @param plants in any order; the rows are ordered across their direction, towards its left
/// Thread-safe; deterministic.
std::vector<RowSummary> summariseRows(const std::vector<Phenotype>& plants);

/// How much of a stand's ground is covered at a height.
struct CanopyLayer {
  double height = 0.0;  ///< above the soil [m]
  Trait cover;  ///< share of the ground under plants that is covered at this height or above
};

/// Canopy height profile, in layers of 10 cm from the soil up to the highest plant: the ground is
/// cut into cells of 20 cm, about a plant's share, of which those with plant points are counted,
/// each by its highest point; the standard deviation is that of counting so many cells. Only
/// measured points of plants, in the tiles that the blocks own, count. Empty without any.
/// Thread-safe; deterministic.
std::vector<CanopyLayer> canopyProfile(
    const std::vector<std::shared_ptr<const CompletedBlock>>& blocks);

}  // namespace field_phenotyping
