#include "pcl_stages.hpp"

#include <pcl/ModelCoefficients.h>
#include <pcl/features/normal_3d_omp.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/region_growing.h>
#include <pcl/segmentation/sac_segmentation.h>

#include <limits>

namespace field_phenotyping::benchmark {
namespace {

pcl::search::KdTree<pcl::PointXYZ>::Ptr newTree() {
  return pcl::search::KdTree<pcl::PointXYZ>::Ptr(new pcl::search::KdTree<pcl::PointXYZ>);
}

}  // namespace

PclPoints::Ptr toPcl(const std::vector<Eigen::Vector3f>& points) {
  PclPoints::Ptr cloud(new PclPoints);
  cloud->reserve(points.size());
  for (const Eigen::Vector3f& p : points) cloud->push_back({p.x(), p.y(), p.z()});
  return cloud;
}

PclPoints::Ptr voxelGrid(const PclPoints::Ptr& points, float edge) {
  pcl::VoxelGrid<pcl::PointXYZ> grid;
  grid.setLeafSize(edge, edge, edge);
  grid.setInputCloud(points);
  PclPoints::Ptr centroids(new PclPoints);
  grid.filter(*centroids);
  return centroids;
}

pcl::PointIndices planePoints(const PclPoints::Ptr& points, const PlaneSearch& search) {
  pcl::SACSegmentation<pcl::PointXYZ> segmentation;
  segmentation.setModelType(pcl::SACMODEL_PERPENDICULAR_PLANE);
  segmentation.setMethodType(pcl::SAC_RANSAC);
  segmentation.setAxis(Eigen::Vector3f::UnitZ());
  segmentation.setEpsAngle(search.max_tilt);
  segmentation.setDistanceThreshold(search.tolerance);
  segmentation.setProbability(search.confidence);
  segmentation.setMaxIterations(search.max_iterations);
  segmentation.setOptimizeCoefficients(true);
  segmentation.setInputCloud(points);
  pcl::PointIndices on_plane;
  pcl::ModelCoefficients plane;
  segmentation.segment(on_plane, plane);
  return on_plane;
}

PclNormals::Ptr estimateNormals(const PclPoints::Ptr& points, int neighbours, int threads) {
  pcl::NormalEstimationOMP<pcl::PointXYZ, pcl::Normal> estimation(static_cast<unsigned>(threads));
  estimation.setInputCloud(points);
  estimation.setSearchMethod(newTree());
  estimation.setKSearch(neighbours);
  PclNormals::Ptr normals(new PclNormals);
  estimation.compute(*normals);
  return normals;
}

std::vector<pcl::PointIndices> growRegions(const PclPoints::Ptr& points,
                                           const PclNormals::Ptr& normals,
                                           const RegionGrowth& settings) {
  pcl::RegionGrowing<pcl::PointXYZ, pcl::Normal> growing;
  growing.setMinClusterSize(settings.min_points);
  growing.setMaxClusterSize(std::numeric_limits<int>::max());
  growing.setSearchMethod(newTree());
  growing.setNumberOfNeighbours(static_cast<unsigned>(settings.neighbours));
  growing.setInputCloud(points);
  growing.setInputNormals(normals);
  growing.setSmoothnessThreshold(static_cast<float>(settings.smoothness));
  growing.setCurvatureThreshold(static_cast<float>(settings.curvature));
  std::vector<pcl::PointIndices> regions;
  growing.extract(regions);
  return regions;
}

}  // namespace field_phenotyping::benchmark
