#pragma once

#include <vector>

namespace field_phenotyping {

/// A stretch of a stem that is grown with one start-end pair and one M (paper 3.1.2).
struct StemSegment {
  float begin = 0.0F;      ///< arc length on the midline [m]
  float end = 0.0F;        ///< [m]
  bool branching = false;  ///< at a node or where a leaf, an ear or a tassel branch leaves the stem
};

/// Splits a stem of that length [m] into segments from the base up: short ones at its branchings,
/// smooth internodes between, which are cut where a straight line would leave a curved stem.
/// @param branchings arc lengths [m] where organs leave the stem, ascending: see LeafBases
std::vector<StemSegment> splitStem(float length, const std::vector<float>& branchings);

}  // namespace field_phenotyping
