#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping {

/// The points of a cloud before it was thinned; empty where it was not.
struct DensePoints {
  std::vector<Eigen::Vector3f> points;  ///< in the cloud's local frame [m]
  std::vector<std::uint32_t>
      thinned;  ///< for each the point of the thinned cloud that stands for it

  bool empty() const { return points.empty(); }
};

/// Thins a cloud that is so dense that more points tell no more of its plants: its voxels are
/// widened until at most `density` [1/m^2] of them lie on the ground that any lies above. Each
/// keeps its centroid, and its first point's colour; where voxels are so wide that centroids would
/// lie inside of stems, the first point itself. Few plants keep all of their points. Thread-safe.
/// @param cloud of what stands above the soil
/// @param edge of the voxels that its points are centroids of [m]
/// @return what it was before
DensePoints thin(PointCloud& cloud, double density, double edge);

}  // namespace field_phenotyping
