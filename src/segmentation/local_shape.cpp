#include "field_phenotyping/segmentation/local_shape.hpp"

#include <Eigen/Eigenvalues>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kMinNeighbors = 5U;

}  // namespace

LocalShape computeLocalShape(const Eigen::Vector3f& point,
                             const std::vector<Eigen::Vector3f>& points, const NeighborGrid& grid,
                             float radius) {
  // Moments about the point itself keep float precision wherever the cloud lies.
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  Eigen::Vector3f squares = Eigen::Vector3f::Zero();
  Eigen::Vector3f products = Eigen::Vector3f::Zero();  // yx, zy, xz
  LocalShape shape;
  grid.forEachOffsetWithin(point, radius, [&](std::uint32_t, const Eigen::Vector3f& offset, float) {
    sum += offset;
    squares += offset.cwiseAbs2();
    products.x() += offset.y() * offset.x();
    products.y() += offset.z() * offset.y();
    products.z() += offset.x() * offset.z();
    ++shape.neighbors;
  });
  if (shape.neighbors < kMinNeighbors) return shape;
  const auto count = static_cast<float>(shape.neighbors);
  const Eigen::Vector3f mean = sum / count;
  Eigen::Matrix3f covariance;
  covariance << squares.x(), products.x(), products.z(),  //
      products.x(), squares.y(), products.y(),            //
      products.z(), products.y(), squares.z();
  covariance = covariance / count - mean * mean.transpose();

  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> solver;
  solver.computeDirect(covariance);
  const Eigen::Vector3f values = solver.eigenvalues().cwiseMax(0.0F);
  if (!(values[2] > 0.0F)) return shape;
  shape.direction = solver.eigenvectors().col(2);
  if (shape.direction.z() < 0.0F) shape.direction = -shape.direction;
  shape.normal = solver.eigenvectors().col(0);
  shape.linearity = (values[2] - values[1]) / values[2];
  shape.curvature = values[0] / values.sum();
  return shape;
}

std::vector<LocalShape> computeLocalShapes(const std::vector<Eigen::Vector3f>& points,
                                           const NeighborGrid& grid, float radius) {
  std::vector<LocalShape> shapes(points.size());
  constexpr std::size_t kChunk = 1024U;
  parallelFor((points.size() + kChunk - 1U) / kChunk, [&](std::size_t chunk) {
    const std::size_t end = std::min(points.size(), (chunk + 1U) * kChunk);
    for (std::size_t i = chunk * kChunk; i < end; ++i) {
      shapes[i] = computeLocalShape(points[i], points, grid, radius);
    }
  });
  return shapes;
}

}  // namespace field_phenotyping
