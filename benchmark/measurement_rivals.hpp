#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace field_phenotyping::benchmark {

/// Another method of Table 3 of the paper with one of its settings.
struct RivalValue {
  std::string method;
  std::string settings;
  double value = 0.0;  ///< [m]; NaN where the method finds none
};

/// Stem diameters by other methods, each with all settings of a small grid:
/// - paper mode: Eq 27 as printed;
/// - circle: least squares of the distance to a circle;
/// - voxel: voxels across the stem that hold points, filled in between; the circle of that area;
/// - projection: width of the silhouette in side views, by pixels; mean or widest view.
/// @param points (x, y, height): across and along the stem's axis, height 0 where the diameter is
///        wanted [m]
std::vector<RivalValue> rivalDiameters(const std::vector<Eigen::Vector3d>& points);

/// Plant heights by other methods, likewise:
/// - voxel: top of the highest layer of voxels that holds enough points;
/// - projection: the highest row of pixels of a side view, in which enough are set.
/// @param points of the plant, z above the soil at its base [m]
std::vector<RivalValue> rivalHeights(const std::vector<Eigen::Vector3d>& points);

}  // namespace field_phenotyping::benchmark
