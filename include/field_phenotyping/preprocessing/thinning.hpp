#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping {

/// The points of a block before it was thinned; empty where it was not.
struct DensePoints {
  std::vector<Eigen::Vector3f> points;  ///< in the block's local frame [m]
  /// For each the point that stands for it: in the thinned cloud or, counted on, in the thinned
  /// feet or isolated points.
  std::vector<std::uint32_t> thinned;

  bool empty() const { return points.empty(); }
};

/// Thins a cloud that is so dense that more points tell little more of its plants: its voxels are
/// widened until at most `density` [1/m^2] of them lie on the ground that any lies above. Each
/// keeps its centroid, and its first point's colour; where voxels are so wide that centroids would
/// lie inside of stems, the first point itself. Few plants keep all of their points. Thread-safe.
/// @param cloud of what stands above the soil
/// @param feet  the soil beside it: thinned to the same voxels
/// @param isolated points that were taken out of the cloud: likewise
/// @param edge  of the voxels that their points are centroids of [m]
/// @return what they were before
DensePoints thin(PointCloud& cloud, PointCloud& feet, PointCloud& isolated, double density,
                 double edge);

}  // namespace field_phenotyping
