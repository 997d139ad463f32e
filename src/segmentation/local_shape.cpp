#include "field_phenotyping/segmentation/local_shape.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kMinNeighbors = 5U;

/// Sums over the neighbours of a point, about the point itself: that keeps float precision wherever
/// the cloud lies.
struct Moments {
  float count = 0.0F;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  Eigen::Vector3f squares = Eigen::Vector3f::Zero();
  Eigen::Vector3f products = Eigen::Vector3f::Zero();  // xy, yz, zx
};

/// Candidates for the neighbours of all points of one cell, coordinate by coordinate, so that
/// several are looked at at once.
class Candidates {
 public:
  void clear() { count_ = 0U; }
  void add(const Eigen::Vector3f& point) {
    if (count_ == x_.size()) {
      const std::size_t size = 2U * count_ + 64U;
      for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(size);
    }
    x_[count_] = point.x();
    y_[count_] = point.y();
    z_[count_] = point.z();
    ++count_;
  }
  /// Fills the last lanes with what is near to no point.
  void close() {
    while (count_ % kLanes != 0U) add(Eigen::Vector3f::Constant(kFar));
  }

  Moments momentsAbout(const Eigen::Vector3f& point, float radius) const {
    Lanes count{}, sum_x{}, sum_y{}, sum_z{}, xx{}, yy{}, zz{}, xy{}, yz{}, zx{};
    const Lanes limit = Lanes{} + radius * radius;
    const Lanes one = Lanes{} + 1.0F;
    const Lanes none{};
    for (std::size_t k = 0; k < count_; k += kLanes) {
      Lanes x = load(x_, k) - point.x();
      Lanes y = load(y_, k) - point.y();
      Lanes z = load(z_, k) - point.z();
      const auto near = x * x + (y * y + z * z) <= limit;
      x = near ? x : none;
      y = near ? y : none;
      z = near ? z : none;
      count += near ? one : none;
      sum_x += x;
      sum_y += y;
      sum_z += z;
      xx += x * x;
      yy += y * y;
      zz += z * z;
      xy += x * y;
      yz += y * z;
      zx += z * x;
    }
    return {total(count),
            {total(sum_x), total(sum_y), total(sum_z)},
            {total(xx), total(yy), total(zz)},
            {total(xy), total(yz), total(zx)}};
  }

 private:
  static constexpr std::size_t kLanes = 4U;
  static constexpr float kFar = 1e9F;  // [m]
  using Lanes = float __attribute__((vector_size(kLanes * sizeof(float))));

  static Lanes load(const std::vector<float>& values, std::size_t k) {
    return Lanes{values[k], values[k + 1U], values[k + 2U], values[k + 3U]};
  }
  static float total(const Lanes& lanes) { return (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]); }

  std::size_t count_ = 0U;
  std::vector<float> x_;
  std::vector<float> y_;
  std::vector<float> z_;
};

LocalShape shapeOf(const Moments& moments) {
  LocalShape shape;
  shape.neighbors = static_cast<std::uint32_t>(moments.count);
  if (shape.neighbors < kMinNeighbors) return shape;
  const Eigen::Vector3f mean = moments.sum / moments.count;
  Eigen::Matrix3f squares;
  squares << moments.squares.x(), moments.products.x(), moments.products.z(),  //
      moments.products.x(), moments.squares.y(), moments.products.y(),         //
      moments.products.z(), moments.products.y(), moments.squares.z();
  const Eigen::Matrix3f covariance = squares / moments.count - mean * mean.transpose();

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

}  // namespace

LocalShape computeLocalShape(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius) {
  Moments moments;
  grid.forEachOffsetWithin(point, radius, [&](std::uint32_t, const Eigen::Vector3f& offset, float) {
    moments.count += 1.0F;
    moments.sum += offset;
    moments.squares += offset.cwiseAbs2();
    moments.products.x() += offset.x() * offset.y();
    moments.products.y() += offset.y() * offset.z();
    moments.products.z() += offset.z() * offset.x();
  });
  return shapeOf(moments);
}

std::vector<LocalShape> computeLocalShapes(const std::vector<Eigen::Vector3f>& points,
                                           const NeighborGrid& grid, float radius) {
  std::vector<LocalShape> shapes(points.size());
  constexpr std::size_t kChunk = 1024U;
  parallelFor((points.size() + kChunk - 1U) / kChunk, [&](std::size_t chunk) {
    // Cell by cell, since the points of one have their candidates in common.
    Candidates candidates;
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
      grid.forEachNearBox(low, high, radius,
                          [&](const Eigen::Vector3f& point) { candidates.add(point); });
      candidates.close();
      for (; k < next; ++k) {
        const std::uint32_t i = grid.sorted(k);
        shapes[i] = shapeOf(candidates.momentsAbout(points[i], radius));
      }
    }
  });
  return shapes;
}

}  // namespace field_phenotyping
