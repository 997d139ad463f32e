#pragma once

#include <cmath>

#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// Three numbers in a row where Eigen cannot be, with the names of its Vector3d, for what is a
/// template over the vector: its sums may differ from Eigen's in the last bit, never from
/// themselves.
class Vector3 {
 public:
  Vector3() = default;
  FIELD_PHENOTYPING_HD Vector3(double x, double y, double z) : x_(x), y_(y), z_(z) {}

  FIELD_PHENOTYPING_HD double x() const { return x_; }
  FIELD_PHENOTYPING_HD double y() const { return y_; }
  FIELD_PHENOTYPING_HD double z() const { return z_; }

  FIELD_PHENOTYPING_HD double dot(const Vector3& o) const {
    return x_ * o.x_ + y_ * o.y_ + z_ * o.z_;
  }
  FIELD_PHENOTYPING_HD Vector3 cross(const Vector3& o) const {
    return {y_ * o.z_ - z_ * o.y_, z_ * o.x_ - x_ * o.z_, x_ * o.y_ - y_ * o.x_};
  }
  FIELD_PHENOTYPING_HD double squaredNorm() const { return dot(*this); }
  FIELD_PHENOTYPING_HD double norm() const { return std::sqrt(squaredNorm()); }
  /// Itself where it has no length.
  FIELD_PHENOTYPING_HD Vector3 normalized() const {
    const double square = squaredNorm();
    return square > 0.0 ? *this / std::sqrt(square) : *this;
  }

  FIELD_PHENOTYPING_HD Vector3& operator+=(const Vector3& o) { return *this = *this + o; }
  FIELD_PHENOTYPING_HD Vector3 operator+(const Vector3& o) const {
    return {x_ + o.x_, y_ + o.y_, z_ + o.z_};
  }
  FIELD_PHENOTYPING_HD Vector3 operator-(const Vector3& o) const {
    return {x_ - o.x_, y_ - o.y_, z_ - o.z_};
  }
  FIELD_PHENOTYPING_HD Vector3 operator/(double by) const { return {x_ / by, y_ / by, z_ / by}; }
  FIELD_PHENOTYPING_HD friend Vector3 operator*(double by, const Vector3& v) {
    return {by * v.x_, by * v.y_, by * v.z_};
  }

 private:
  double x_, y_, z_;
};

}  // namespace field_phenotyping
