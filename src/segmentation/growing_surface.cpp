#include "field_phenotyping/segmentation/growing_surface.hpp"

#include <cmath>

namespace field_phenotyping {

float GrowingSurface::longestCarried(float radius) {
  constexpr double kBending = 0.11;  // [1/sqrt(m)] of the slope, which walks at random: a lean that
                                     // wanders by 6 degrees over 1 m
  // Across, that is kBending sqrt(gap^3 / 3): one standard deviation may be a diameter.
  const double across = 2.0 * static_cast<double>(radius) / kBending;
  return static_cast<float>(std::cbrt(3.0 * across * across));
}

}  // namespace field_phenotyping
