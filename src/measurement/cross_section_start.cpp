#include "field_phenotyping/measurement/cross_section_start.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/measurement/ellipse_fit.hpp"

namespace field_phenotyping {
namespace {

KnownOfStem knownBy(const CrossSectionPrior& prior) {
  return {prior.noise,
          prior.log_noise.value,
          prior.log_noise.stddev,
          prior.elongation.value,
          prior.radius.value,
          prior.radius.stddev,
          prior.ellipticity_stddev,
          prior.taper.value,
          prior.taper.stddev,
          prior.taper_change.value,
          prior.taper_change.stddev};
}

/// Offsets from the parabola in height that fits the points best.
std::vector<Eigen::Vector2d> straightened(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Matrix3d normal = 1e-12 * Eigen::Matrix3d::Identity();
  Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d row(1.0, point.z(), point.z() * point.z());
    normal += row * row.transpose();
    right += row * point.head<2>().transpose();
  }
  const Eigen::Matrix<double, 3, 2> line = normal.ldlt().solve(right);
  std::vector<Eigen::Vector2d> offsets;
  offsets.reserve(points.size());
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d row(1.0, point.z(), point.z() * point.z());
    offsets.emplace_back(point.head<2>() - line.transpose() * row);
  }
  return offsets;
}

StemExtent extentOf(const std::vector<Eigen::Vector3d>& points) {
  constexpr double kTrim = 2.5;  // median distances
  StemExtent extent;
  for (const Eigen::Vector3d& point : points) {
    extent.reach = std::max(extent.reach, point.head<2>().norm());
  }
  const std::vector<Eigen::Vector2d> offsets = straightened(points);
  std::vector<double> distances;
  for (const Eigen::Vector2d& offset : offsets) distances.push_back(offset.norm());
  const double limit = kTrim * medianOf(distances);
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  double count = 0.0;
  for (const Eigen::Vector2d& offset : offsets) {
    if (offset.norm() > limit) continue;
    scatter += offset * offset.transpose();
    count += 1.0;
  }
  const double mean = 0.5 * scatter.trace() / count;
  const double difference =
      std::hypot(0.5 * (scatter(0, 0) - scatter(1, 1)), scatter(0, 1)) / count;
  extent.width_variance = mean + difference;  // the larger eigenvalue
  extent.depth_variance = mean - difference;
  return extent;
}

/// A circle round `center` through the middle of the points.
CrossSectionVector circleStart(const std::vector<Eigen::Vector3d>& points,
                               const Eigen::Vector2d& center, const CrossSectionPrior& prior) {
  std::vector<double> distances;
  distances.reserve(points.size());
  for (const Eigen::Vector3d& point : points) {
    distances.push_back((point.head<2>() - center).norm());
  }
  const double radius = std::max(medianOf(distances), 1e-6);
  for (double& distance : distances) distance = std::abs(distance - radius);
  const double scatter = prior.noise > 0.0 ? prior.noise : 1.48 * medianOf(distances);
  CrossSectionVector start;
  start[kCenter] = center.x();
  start[kCenter + 1] = center.y();
  start[kRadius] = radius;
  start[kTaper] = prior.taper.value * radius;
  start[kTaperChange] = prior.taper_change.value * radius;
  start[kNoise] = std::log(std::clamp(scatter, 0.05 * radius, 0.9 * radius));
  return start;
}

}  // namespace

CrossSectionTask crossSectionTask(const std::vector<Eigen::Vector3d>& points,
                                  const CrossSectionPrior& prior, const CrossSectionStart* near) {
  CrossSectionTask task;
  task.known = knownBy(prior);
  task.extent = extentOf(points);
  if (near != nullptr) {
    task.near = *near;
    task.has_near = !start::isShapeless(near->parameters);
    task.shapeless = !task.has_near;
    if (task.has_near) return task;
  }
  task.of_axis = circleStart(points, Eigen::Vector2d::Zero(), prior);
  std::vector<Eigen::Vector2d> flat;
  flat.reserve(points.size());
  for (const Eigen::Vector3d& point : points) flat.push_back(point.head<2>());
  const CircleFit circle = fitCircle(flat);
  task.has_circle = circle.valid && circle.radius < 2.0 * task.extent.reach;
  if (task.has_circle) task.of_circle = circleStart(points, circle.center, prior);
  return task;
}

CrossSectionPoints placesOf(const std::vector<Eigen::Vector3d>& points) {
  static_assert(sizeof(Eigen::Vector3d) == 3U * sizeof(double), "points are taken as they are");
  return {points.empty() ? nullptr : points.front().data(), static_cast<int>(points.size())};
}

CrossSectionStart startCrossSection(const CrossSectionPoints& points,
                                    const CrossSectionTask& task) {
  start::Record record;
  start::Sums sums;
  double matrix[kCrossSectionSize * kCrossSectionSize];
  double vector[kCrossSectionSize];
  double solution[kCrossSectionSize];
  return withWideVectors([&] {
    return startCrossSection(SerialTeam(), points, task,
                             {&record, &sums, matrix, vector, solution});
  });
}

}  // namespace field_phenotyping
