#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/organ_cells.hpp"

namespace field_phenotyping {

/// Cells that run on smoothly: part of one leaf, rarely of two.
struct LeafPieces {
  std::vector<std::int32_t> of_cell;              ///< -1: in no piece
  std::vector<std::vector<std::uint32_t>> cells;  ///< of each piece
};

/// What a piece of so many cells has to say, of what one of a whole leaf has: in [0, 1].
inline float sayOfPiece(float cells) {
  constexpr float kWhole = 30.0F;
  return std::min(1.0F, cells / kWhole);
}

/// Finds pieces of leaves: cells on one smooth ribbon, each carried on through crossings as it
/// foretells. The cells of a piece get the shape of that piece alone.
LeafPieces findLeafPieces(OrganCells& cells);

/// A piece that may go on in another, and what that costs.
struct PieceLink {
  std::uint32_t piece = 0U;
  float cost = 0.0F;
};

/// Links pieces that lie in each other's continuation: dear over gaps, and dearer round bends.
/// @param reach [m] longest gap
/// @return of each piece, both ways
std::vector<std::vector<PieceLink>> linkLeafPieces(const OrganCells& cells,
                                                   const LeafPieces& pieces, float reach);

}  // namespace field_phenotyping
