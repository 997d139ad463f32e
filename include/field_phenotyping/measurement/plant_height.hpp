#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Height of one plant [m]; NaN without points.
struct PlantHeight {
  Trait height;
  std::uint32_t flags = kOk;
};

/// Heights of a block's plants, in their order: the vertical distance from the soil at the plant's
/// base to the plant's top (paper 2.7).
///
/// The beams miss the very tip. What they miss is about the mean spacing in height of the highest
/// points, or up to two and a half times that where points thin out towards the tip, as on a leaf:
/// there spacings grow upwards, which all plants of the block together show. A few spacings of one
/// plant say little, and where by chance the highest point is far up they say too much. So they are
/// taken from all plants of the block (empirical Bayes), each being drawn towards its own as far as
/// the plants differ by more than chance. What is missed is added, and enters the standard
/// deviation beside that of the soil; a plant whose highest points are farther apart than in any
/// stand may have been given another's, and its own spacing enters there.
///
/// Where hardly anything is seen about the highest points, nothing leads from one to the next, and
/// which plant they are of can be told by where they stand only: the standard deviation grows, by
/// up to a twentieth of the plant's height. It grows also where the top may be another plant's, or
/// the plant's own has been given to another (Plant::top_stddev).
///
/// Without soil in the block the height is that above the lowest point of the plant, its standard
/// deviation that of the sampling only. In mode "paper": the highest point, nothing added.
/// Thread-safe; deterministic; plants are worked side by side. Their outermost points are looked
/// for on the GPU where there is one, a thread block for each plant, with the same result.
///
/// @param noise of a point [m]: spacings that are smaller say little of how points thin out
std::vector<PlantHeight> measurePlantHeights(const SegmentedBlock& block,
                                             const MeasurementParameters& parameters, double noise,
                                             const ComputeDevice& device = {});

}  // namespace field_phenotyping
