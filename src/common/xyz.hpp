#pragma once

#include <Eigen/Core>
#include <vector>

namespace field_phenotyping {

/// The points as x y z x y z ..., as they lie in memory; null when there are none.
inline const float* xyzOf(const std::vector<Eigen::Vector3f>& points) {
  static_assert(sizeof(Eigen::Vector3f) == 3U * sizeof(float), "points lie side by side");
  return points.empty() ? nullptr : points.front().data();
}

}  // namespace field_phenotyping
