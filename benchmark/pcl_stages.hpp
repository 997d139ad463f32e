#pragma once

#include <pcl/PointIndices.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <Eigen/Core>
#include <vector>

// The parts of the Point Cloud Library that do what stages of the pipeline do, to compare with.

namespace field_phenotyping::benchmark {

using PclPoints = pcl::PointCloud<pcl::PointXYZ>;
using PclNormals = pcl::PointCloud<pcl::Normal>;

PclPoints::Ptr toPcl(const std::vector<Eigen::Vector3f>& points);

/// pcl::VoxelGrid: a centroid a voxel. @param edge [m]
PclPoints::Ptr voxelGrid(const PclPoints::Ptr& points, float edge);

/// How soil is looked for by pcl::SACSegmentation.
struct PlaneSearch {
  double tolerance = 0.08;    ///< [m] of a point from the plane
  double max_tilt = 0.44;     ///< [rad] of the plane
  double confidence = 0.99;   ///< to have drawn three points of the plane
  int max_iterations = 5000;  ///< where fewer do not give that confidence
};

/// pcl::SACSegmentation by RANSAC, refined by least squares: the points on the plane.
pcl::PointIndices planePoints(const PclPoints::Ptr& points, const PlaneSearch& search);

/// pcl::NormalEstimationOMP. @param threads 0: all cores
PclNormals::Ptr estimateNormals(const PclPoints::Ptr& points, int neighbours, int threads);

/// Settings of pcl::RegionGrowing.
struct RegionGrowth {
  int min_points = 20;
  int neighbours = 30;
  double smoothness = 0.35;  ///< most angle between neighbouring normals [rad]
  double curvature = 0.1;    ///< most of a point to grow on from
};

std::vector<pcl::PointIndices> growRegions(const PclPoints::Ptr& points,
                                           const PclNormals::Ptr& normals,
                                           const RegionGrowth& settings);

}  // namespace field_phenotyping::benchmark
