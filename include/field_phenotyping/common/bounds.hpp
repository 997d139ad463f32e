#pragma once

#include <Eigen/Core>
#include <vector>

namespace field_phenotyping {

/// The least box along the axes that holds some points [m].
struct Bounds {
  Eigen::Vector3f low;
  Eigen::Vector3f high;
};

/// @param points one at least
Bounds boundsOf(const std::vector<Eigen::Vector3f>& points);

}  // namespace field_phenotyping
