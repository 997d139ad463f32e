#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/segmentation/isolated_points.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Whose the tops of a stand's plants are. Where plants stand close a tassel, or a tip, may have
/// been given to a neighbour. Its place tells: a plant's highest points stand about the straight
/// line that its stem points along, as far off it as those of the stand do. A top is *disputed*
/// that is nearer to another plant's line.
///
/// Were all right, some would be disputed by chance, the more the farther tips stand off their
/// lines (Rayleigh distributed, in any direction), as the tips of leaves do.
///
/// Lengths in metres, in the local frame of the points. Pure functions; deterministic; plants are
/// worked side by side. A plant without an axis, or with less than three points, has no part.

/// Gives tops back to plants that have lost theirs: one whose own highest points are far off its
/// line, while others hold many points far above them that are nearer to its line than to theirs.
/// Only in a stand where hardly a top is disputed by chance. Points of stems stay theirs.
/// @return standard deviation of each plant's highest point [m] by what was given: about half of it
/// is given wrongly where real plants stand close
std::vector<float> giveTopsBack(const std::vector<Eigen::Vector3f>& points,
                                const std::vector<StemAxis>& axes, PointOwners& owners);

/// Standard deviation of each plant's highest point [m] by the doubt whose it is; 0 where no other
/// plant may have lost it, nor holds the plant's own.
///
/// How many tops are disputed beyond those by chance says what share of them is wrong (empirical
/// Bayes). With that probability the top is as far down as the highest point that is not disputed;
/// or, where it is far off its own line, as far up as what others hold nearer to that line.
std::vector<float> doubtTops(const SegmentedBlock& block);

}  // namespace field_phenotyping
