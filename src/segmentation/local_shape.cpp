#include "field_phenotyping/segmentation/local_shape.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/neighborhood.hpp"

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kMinNeighbors = 5U;

LocalShape shapeOf(const Moments& moments) {
  LocalShape shape;
  shape.neighbors = static_cast<std::uint32_t>(moments.count);
  if (shape.neighbors < kMinNeighbors) return shape;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> solver;
  solver.computeDirect(moments.covariance());
  const Eigen::Vector3f values = solver.eigenvalues().cwiseMax(0.0F);
  if (!(values[2] > 0.0F)) return shape;
  shape.direction = solver.eigenvectors().col(2);
  if (shape.direction.z() < 0.0F) shape.direction = -shape.direction;
  shape.normal = solver.eigenvectors().col(0);
  shape.linearity = (values[2] - values[1]) / values[2];
  shape.curvature = values[0] / values.sum();
  return shape;
}

}  // namespace

LocalShape computeLocalShape(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius) {
  Moments moments;
  grid.forEachOffsetWithin(point, radius, [&](std::uint32_t, const Eigen::Vector3f& offset, float) {
    moments.add(offset);
  });
  return shapeOf(moments);
}

std::vector<LocalShape> computeLocalShapes(const std::vector<Eigen::Vector3f>& points,
                                           const NeighborGrid& grid, float radius) {
  std::vector<LocalShape> shapes(points.size());
  constexpr std::size_t kChunk = 1024U;
  parallelFor((points.size() + kChunk - 1U) / kChunk, [&](std::size_t chunk) {
    // Cell by cell, since the points of one have their candidates in common.
    Neighborhood candidates;
    const std::size_t begin = chunk * kChunk;
    const std::size_t end = std::min(points.size(), begin + kChunk);
    for (std::size_t k = begin; k < end;) {
      Eigen::Vector3f low = points[grid.sorted(k)];
      Eigen::Vector3f high = low;
      std::size_t next = k + 1U;
      for (; next < end && grid.inOneCell(k, next); ++next) {
        low = low.cwiseMin(points[grid.sorted(next)]);
        high = high.cwiseMax(points[grid.sorted(next)]);
      }
      candidates.clear();
      grid.forEachRunNearBox(low, high, radius,
                             [&](const NeighborGrid::Coordinates& run) { candidates.add(run); });
      for (; k < next; ++k) {
        const std::uint32_t i = grid.sorted(k);
        shapes[i] = shapeOf(candidates.momentsAbout(points[i], radius));
      }
    }
  });
  return shapes;
}

}  // namespace field_phenotyping
