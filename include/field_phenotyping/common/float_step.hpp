#pragma once

#include <cmath>
#include <limits>

namespace field_phenotyping {

/// From a coordinate in single precision to the next one that it can be told from, in its unit.
inline double floatStep(double coordinate) {
  const auto here = static_cast<float>(std::abs(coordinate));
  return static_cast<double>(std::nextafter(here, std::numeric_limits<float>::infinity()) - here);
}

}  // namespace field_phenotyping
