#pragma once

#include <limits>
#include <vector>

#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {

/// How densely a block's surfaces are sampled above the height at which they are sampled best, to
/// that height: beams meet the tops of plants taller than the sensor from below and through other
/// leaves, so that few points of a stem there say as much as many farther down.
/// Immutable; thread-safe.
class SamplingProfile {
 public:
  /// All heights alike.
  SamplingProfile() = default;
  /// @param heights of the points above the soil [m]; those of soil are left out
  /// @param shapes  of the same points, whose neighbours are counted
  /// @param canopy  about how high the plants are [m]
  SamplingProfile(const std::vector<float>& heights, const std::vector<LocalShape>& shapes,
                  double canopy);

  /// Density at a height above the soil [m], in (0, 1]: 1 up to the best one, falling above.
  double at(double height) const;

  /// The same of what is seen of stems. Leaves hide them: their points get fewer lower down than
  /// those of the leaves themselves.
  double ofStems(double height) const { return at(height + hidden_); }

  /// Height above the soil [m], above the best one, where points first have so few neighbours that
  /// nothing leads from one to the next; infinite where that is nowhere so.
  double sparseFrom() const { return sparse_from_; }

 private:
  std::vector<double> bands_;  // of equal height, upwards from the soil
  double hidden_ = 0.0;        // [m] that stems are seen less from lower down
  double sparse_from_ = std::numeric_limits<double>::infinity();
};

}  // namespace field_phenotyping
