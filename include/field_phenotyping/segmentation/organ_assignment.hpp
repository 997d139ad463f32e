#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Whose the organs of a block are.
struct OrganOwners {
  /// Per point: index of the plant; what no stem reaches stays -1.
  std::vector<std::int32_t> plant;
  /// Of each plant: standard deviation of the height of its highest point [m], by the doubt whose
  /// the pieces of leaves up there are: its own that fit another plant nearly as well, and others'
  /// that fit it nearly as well.
  std::vector<float> top_stddev;
};

/// Gives every other organ to its plant.
///
/// Leaves are taken in pieces that run on smoothly, through crossings where they foretell it. A
/// piece goes to one plant as a whole: to the one that gets at it, from the stem or through pieces
/// that it continues, with the fewest and straightest gaps and through the best fitting pieces.
/// What fits is learnt from the block: leaves point at their stem, rise from it, flatten and droop,
/// and in stands with tassels stay below the tops of their stems.
/// A piece counts by how much worse it fits one plant than the one that it fits best.
/// Then every plant in turn takes the pieces that make it and all links between pieces of two
/// plants cost least (alpha expansion: Boykov, Veksler and Zabih, 2001). What carries on a stem
/// beyond its end is given to its plant before (see followStemsUp()). What is no piece follows
/// along shortest paths over the cloud.
///
/// Pure function; time grows with the number of points. All lengths in metres, in the local frame
/// of the block's cloud.
///
/// @param axes  stem axis of each plant; a plant that owns no point gets none
/// @param owner per point of `block.cloud`: index of the plant whose stem holds it, or -1
/// @return the same array with leaves and tassels filled in, and how sure their tops are
OrganOwners assignOrgans(const Block& block, const std::vector<StemAxis>& axes,
                         std::vector<std::int32_t> owner, const SegmentationParameters& parameters,
                         const ComputeDevice& device = {});

}  // namespace field_phenotyping
