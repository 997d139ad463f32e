#pragma once

#include <Eigen/Core>
#include <limits>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Mean direction of a stem: the chord from its base to the top of its axis.
struct Lean {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();            ///< unit, upwards
  Trait angle;                                                ///< from vertical [rad]
  double azimuth = std::numeric_limits<double>::quiet_NaN();  ///< from x towards y [rad]
};

/// Both ends of the axis count as known to half the stem's radius. NaN without an axis.
/// Thread-safe.
Lean measureLean(const Plant& plant);

}  // namespace field_phenotyping
