#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {

/// Sums over the neighbours of a point, of their offsets from it [m]: so floats stay precise
/// wherever the cloud lies.
struct Moments {
  float count = 0.0F;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  Eigen::Vector3f squares = Eigen::Vector3f::Zero();
  Eigen::Vector3f products = Eigen::Vector3f::Zero();  ///< xy, yz, zx

  void add(const Eigen::Vector3f& offset) {
    count += 1.0F;
    sum += offset;
    squares += offset.cwiseAbs2();
    products.x() += offset.x() * offset.y();
    products.y() += offset.y() * offset.z();
    products.z() += offset.z() * offset.x();
  }
  Eigen::Vector3f mean() const { return sum / count; }
  Eigen::Matrix3f covariance() const {
    Eigen::Matrix3f matrix;
    matrix << squares.x(), products.x(), products.z(),  //
        products.x(), squares.y(), products.y(),        //
        products.z(), products.y(), squares.z();
    return matrix / count - mean() * mean().transpose();
  }
};

/// Points that may be neighbours of one or more places, stored coordinate by coordinate so that the
/// processor looks at several at once.
class Neighborhood {
 public:
  void clear() { count_ = 0U; }
  void add(const Eigen::Vector3f& point) {
    reserve(1U);
    x_[count_] = point.x();
    y_[count_] = point.y();
    z_[count_] = point.z();
    ++count_;
  }
  void add(const NeighborGrid::Coordinates& run) {
    reserve(run.count);
    for (std::size_t k = 0; k < run.count; k += kLanes) {
      store(loadFloats(run.x + k), &x_[count_ + k]);
      store(loadFloats(run.y + k), &y_[count_ + k]);
      store(loadFloats(run.z + k), &z_[count_ + k]);
    }
    count_ += run.count;
  }

  /// Moments of the points within `radius` [m] of `place`.
  Moments momentsAbout(const Eigen::Vector3f& place, float radius) const;

 private:
  /// Makes room for points, and for the lanes beyond them.
  void reserve(std::size_t points) {
    if (count_ + points + kLanes > x_.size()) grow(points);
  }
  void grow(std::size_t points);

  std::size_t count_ = 0U;
  std::vector<float> x_;  // padded, so that the last lanes can be loaded
  std::vector<float> y_;
  std::vector<float> z_;
};

}  // namespace field_phenotyping
