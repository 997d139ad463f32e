#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "field_phenotyping/completion/curve_frame.hpp"

namespace field_phenotyping {

/// A point in the coordinates of the unrolled stem.
struct UnrolledPoint {
  double theta = 0.0;  ///< angle round the axis from the frame's u towards v, in [-pi, pi] [rad]
  double s = 0.0;      ///< arc length along the axis [m]; < 0 before its start
  double r = 0.0;      ///< distance from the axis [m]
};

/// Curved stem axis with a rotation-minimising frame: maps points to the unrolled stem
/// (theta, s, r) and back. On the unrolled stem an upright surface is single-valued, which the
/// paper's z = f(x, y) (Eq 18) is not.
///
/// Metres, in the local frame of the block's cloud. Beyond its ends the axis goes on straight. The
/// map is one-to-one for r below the axis' radius of curvature. Immutable, so safe to read from any
/// thread.
class StemFrame {
 public:
  using Frame = CurveFrame<Eigen::Vector3d>;

  /// @param curve points along the axis, upwards, closely spaced against its curvature
  /// @throws std::invalid_argument for fewer than two points or two points in one place
  explicit StemFrame(const std::vector<Eigen::Vector3d>& curve);

  UnrolledPoint unroll(const Eigen::Vector3d& point) const;
  /// @param[out] outward unit vector from the axis to the point
  UnrolledPoint unroll(const Eigen::Vector3d& point, Eigen::Vector3d& outward) const;
  Eigen::Vector3d roll(const UnrolledPoint& point) const;
  Frame at(double s) const;

  double length() const { return nodes_.back().s; }
  const std::vector<Frame>& nodes() const { return nodes_; }

 private:
  int count() const { return static_cast<int>(nodes_.size()); }

  std::vector<Frame> nodes_;
};

}  // namespace field_phenotyping
