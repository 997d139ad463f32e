#pragma once

#include <cstddef>

#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping {

/// Points on a square metre, seen from above, where there are any: the median over some of the
/// points. Tells clouds in metres from those in other units. 0 where no point is finite.
/// Thread-safe; deterministic.
std::size_t usualDensity(const PointCloud& cloud);

}  // namespace field_phenotyping
