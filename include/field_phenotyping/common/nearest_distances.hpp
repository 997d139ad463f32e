#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <vector>

namespace field_phenotyping {

/// How far the nearest other one of some places is from each; without any, the largest number.
inline std::vector<float> nearestDistances(const std::vector<Eigen::Vector2f>& places) {
  std::vector<float> nearest(places.size(), std::numeric_limits<float>::max());
  for (std::size_t a = 0; a < places.size(); ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      const float apart = (places[a] - places[b]).norm();
      nearest[a] = std::min(nearest[a], apart);
      nearest[b] = std::min(nearest[b], apart);
    }
  }
  return nearest;
}

}  // namespace field_phenotyping
