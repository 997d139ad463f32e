#include "completion_scores.hpp"

#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <Eigen/Eigenvalues>
#include <cmath>

namespace field_phenotyping::benchmark {
namespace {

using Tree = pcl::KdTreeFLANN<pcl::PointXYZ>;

pcl::PointXYZ toPcl(const Eigen::Vector3f& p) {
  return {p.x(), p.y(), p.z()};
}

pcl::PointCloud<pcl::PointXYZ>::Ptr toPcl(const std::vector<Eigen::Vector3f>& points) {
  pcl::PointCloud<pcl::PointXYZ>::Ptr cloud(new pcl::PointCloud<pcl::PointXYZ>);
  for (const Eigen::Vector3f& p : points) cloud->push_back(toPcl(p));
  return cloud;
}

/// Normal by principal axes of a point and its neighbours, as clouds of any origin get them.
double smoothnessOf(const std::vector<Eigen::Vector3f>& points, const Tree& tree) {
  constexpr int kNeighbors = 12;
  if (points.size() <= kNeighbors) return 0.0;
  std::vector<std::vector<int>> neighbors(points.size());
  std::vector<Eigen::Vector3f> normals;
  std::vector<float> squared;
  for (std::size_t i = 0; i < points.size(); ++i) {
    tree.nearestKSearch(toPcl(points[i]), kNeighbors + 1, neighbors[i], squared);
    Eigen::Vector3f mean = Eigen::Vector3f::Zero();
    for (const int j : neighbors[i]) mean += points[static_cast<std::size_t>(j)];
    mean /= static_cast<float>(neighbors[i].size());
    Eigen::Matrix3f spread = Eigen::Matrix3f::Zero();
    for (const int j : neighbors[i]) {
      const Eigen::Vector3f offset = points[static_cast<std::size_t>(j)] - mean;
      spread += offset * offset.transpose();
    }
    normals.emplace_back(
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f>(spread).eigenvectors().col(0));
  }
  double sum = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t k = 1; k < neighbors[i].size(); ++k) {
      sum += std::abs(normals[i].dot(normals[static_cast<std::size_t>(neighbors[i][k])]));
    }
  }
  return sum / (static_cast<double>(points.size()) * kNeighbors);
}

double completenessOf(const Tree& tree, const TrueSurface& truth) {
  constexpr double kReach = 0.005;  // [m]
  std::vector<int> index;
  std::vector<float> squared;
  std::size_t covered = 0U;
  for (const Eigen::Vector3d& sample : truth.samples) {
    if (tree.nearestKSearch(toPcl(sample.cast<float>()), 1, index, squared) > 0 &&
        squared[0] <= static_cast<float>(kReach * kReach)) {
      ++covered;
    }
  }
  return static_cast<double>(covered) / static_cast<double>(truth.samples.size());
}

double resolutionOf(const std::vector<Eigen::Vector3f>& points, const TrueSurface& truth,
                    double density) {
  constexpr float kReach = 0.015F;  // [m] a point farther off belongs to no cell
  std::vector<Eigen::Vector3f> samples;
  for (const Eigen::Vector3d& sample : truth.samples) samples.push_back(sample.cast<float>());
  Tree tree;
  tree.setInputCloud(toPcl(samples));
  std::vector<double> counts(truth.cell_area.size(), 0.0);
  std::vector<int> index;
  std::vector<float> squared;
  for (const Eigen::Vector3f& point : points) {
    if (tree.nearestKSearch(toPcl(point), 1, index, squared) == 0) continue;
    if (squared[0] > kReach * kReach) continue;
    counts[truth.cell[static_cast<std::size_t>(index[0])]] += 1.0;
  }
  std::size_t faithful = 0U;
  for (std::size_t c = 0; c < counts.size(); ++c) {
    const double ratio = counts[c] / truth.cell_area[c] / density;
    if (ratio >= 0.5 && ratio <= 2.0) ++faithful;
  }
  return static_cast<double>(faithful) / static_cast<double>(counts.size());
}

}  // namespace

CloudScore scoreCloud(const std::vector<Eigen::Vector3f>& points, const TrueSurface& truth,
                      double density) {
  if (points.empty()) return {};
  Tree tree;
  tree.setInputCloud(toPcl(points));
  return {completenessOf(tree, truth), smoothnessOf(points, tree),
          resolutionOf(points, truth, density)};
}

SurfaceErrors surfaceErrors(const FilledStem& stem, const TrueSurface& truth) {
  SurfaceErrors errors;
  for (std::size_t i = 0; i < stem.filled.size(); ++i) {
    const auto [distance, reference] = truth.distance(stem.filled[i].cast<double>());
    if (!std::isfinite(distance)) continue;
    ++errors.points;
    errors.squares += distance * distance;
    errors.sum += distance;
    if (stem.stddev.empty()) continue;
    const double stddev = std::hypot(static_cast<double>(stem.stddev[i]), reference);
    if (std::abs(distance) <= 1.96 * stddev) ++errors.covered;
  }
  return errors;
}

}  // namespace field_phenotyping::benchmark
