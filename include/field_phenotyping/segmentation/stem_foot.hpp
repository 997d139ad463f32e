#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/row_model.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"

namespace field_phenotyping {

/// How plants stand, as far as it is known from those that were found.
struct Stand {
  StandLean lean;
  std::optional<RowModel> rows;
  std::vector<Eigen::Vector2d> plants;  ///< their bases, horizontal, local frame [m]
};

/// An axis that has been carried down to the soil.
struct SettledFoot {
  StemAxis axis;
  float hidden = 0.0F;  ///< of Midline
};

/// Where an axis meets the soil [m], in the block's local frame. Thread-safe.
Eigen::Vector3f baseOf(const Block& block, const StemAxis& axis);

/// Axis of a stem whose foot the canopy hides, carried down to the soil anew.
///
/// Where only the top of a stem is seen well, leaves turn the midline by a few degrees, and its
/// foot ends up at a neighbour's. So the foot is chosen among the places round it: it should give
/// the stem a lean that the stand has, agree with the slope of what is seen, meet the few points
/// that are seen further down, lie in a row, and stand as far from its neighbours there as plants
/// do. Straight from there to the middle of the part that is seen. A few plants lean far more than
/// most do: slopes are taken as spread as Student's distribution, not as the normal one.
///
/// @param grid over the points of `block.cloud`
/// @param midline may begin above the soil, where the stem is seen first
/// @param stand   without the plant itself
/// None where the foot is seen, or where the stand's lean is not known: the axis is good as it is.
/// Thread-safe; deterministic.
std::optional<SettledFoot> settleFoot(const Block& block, const NeighborGrid& grid,
                                      const Midline& midline, const Stand& stand);

}  // namespace field_phenotyping
