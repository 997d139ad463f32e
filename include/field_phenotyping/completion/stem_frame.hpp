#pragma once

#include <Eigen/Core>
#include <vector>

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
  /// Axis point and right-handed orthonormal frame (u, v, tangent).
  struct Frame {
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    Eigen::Vector3d tangent = Eigen::Vector3d::UnitZ();
    Eigen::Vector3d u = Eigen::Vector3d::UnitX();
    Eigen::Vector3d v = Eigen::Vector3d::UnitY();
    double s = 0.0;
  };

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
  /// Number of the lower node of the segment that a point between the ends lies beside.
  std::size_t segmentOf(const Eigen::Vector3d& point) const;
  Frame interpolate(std::size_t segment, double share) const;

  std::vector<Frame> nodes_;
};

}  // namespace field_phenotyping
