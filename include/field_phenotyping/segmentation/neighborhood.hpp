#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/principal_axes.hpp"

namespace field_phenotyping {

/// Points that may be neighbours of one or more places, stored coordinate by coordinate so that the
/// processor looks at several at once.
class Neighborhood {
 public:
  void add(const Eigen::Vector3f& point) {
    reserve(count_ + 1U);
    x_[count_] = point.x();
    y_[count_] = point.y();
    z_[count_] = point.z();
    ++count_;
  }

  /// Moments of the points within `radius` [m] of `place`.
  Moments momentsAbout(const Eigen::Vector3f& place, float radius) const {
    const VectorLanes lanes;
    LaneMoments<VectorLanes> sums;
    sums.add(lanes, x_.data(), y_.data(), z_.data(), count_, {place.x(), place.y(), place.z()},
             radius);
    return sums.total(lanes);
  }

 private:
  /// Makes room for points, and for the lanes beyond them.
  void reserve(std::size_t points) {
    if (points + kLanes <= x_.size()) return;
    for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(2U * points + 64U);
  }

  std::size_t count_ = 0U;
  std::vector<float> x_;  // padded, so that the last lanes can be loaded
  std::vector<float> y_;
  std::vector<float> z_;
};

}  // namespace field_phenotyping
