#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// A stretch of a stem that is grown with one start-end pair and one M (paper 3.1.2).
struct StemSegment {
  float begin = 0.0F;      ///< arc length on the midline [m]
  float end = 0.0F;        ///< [m]
  bool branching = false;  ///< at a node or where a leaf, an ear or a tassel branch leaves the stem
};

/// Finds where leaves and other organs leave a stem: the arc lengths [m] at which the space just
/// outside its surface, empty on one side below, fills with points. Ascending. Thread-safe.
///
/// @param points  local frame [m]
/// @param members indices of the points near the midline, those of other organs included
std::vector<float> findBranchings(const std::vector<Eigen::Vector3f>& points,
                                  const std::vector<std::uint32_t>& members,
                                  const Midline& midline);

/// Splits a stem of that length [m] into segments from the base up: short ones at its branchings,
/// smooth internodes between, which are cut where a straight line would leave a curved stem.
std::vector<StemSegment> splitStem(float length, const std::vector<float>& branchings);

}  // namespace field_phenotyping
