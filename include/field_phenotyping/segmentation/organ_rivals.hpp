#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/leaf_form.hpp"
#include "field_phenotyping/segmentation/leaf_pieces.hpp"
#include "field_phenotyping/segmentation/organ_cells.hpp"

namespace field_phenotyping {

/// How much worse a piece fits a plant than the one that it fits best.
struct Misfit {
  std::uint32_t piece = 0U;
  float cost = 0.0F;
};

/// The plant that a piece would be of if not of its own.
struct Rival {
  std::int32_t plant = -1;
  float chance = 0.0F;  ///< that it is
};

/// @param costs    of each plant: the pieces that it can get at, and what they cost it
/// @param plant_of of each piece: the plant that has it, or -1
/// @return of each piece
std::vector<Rival> findRivals(const std::vector<std::vector<Misfit>>& costs,
                              const std::vector<std::int32_t>& plant_of);

/// Of each plant: standard deviation of the height of its highest point [m], by what its rivals may
/// have of it, and it of them. What carries a stem on, or is in no piece, is doubted where it
/// stands among other plants' pieces.
std::vector<float> topStddevsOf(const OrganCells& cells, const LeafPieces& pieces,
                                const std::vector<Rival>& rivals,
                                const std::vector<LeafHost>& hosts);

}  // namespace field_phenotyping
