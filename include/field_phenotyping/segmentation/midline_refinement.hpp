#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// Refines the midline and the radius of a stem that has been found and whose end is about known
/// (2.4.2, Step 1).
///
/// fitMidline() finds a stem anywhere, among leaves it takes to be as dense on one side as on the
/// other, even within the stem. Leaves that clasp it then draw the axis their way and widen it.
/// Here nothing but noise lies within the surface, leaves are as dense outside it as the ring round
/// the stem shows in each direction, and the radius falls with the stem's length.
///
/// @param points  local frame [m]
/// @param members indices of the points round the midline, leaf points included
/// @param plant_height about how high the plant is [m]: a young stem is followed from its bare foot
/// up into the whorl
/// @param widened ratio of the midline's radius to what it is believed to be
/// @return the midline with the same ends; unchanged where there are too few points.
/// Thread-safe; deterministic.
Midline refineMidline(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const Midline& midline,
                      float plant_height, double widened = 1.0);

}  // namespace field_phenotyping
