#pragma once

#include <Eigen/Core>
#include <vector>

namespace field_phenotyping {

/// An ellipse fitted to points of a plane. Metres, radians.
struct EllipseFit {
  bool valid = false;  ///< false: too few points, no solution, or the fit ran away
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double semi_major = 0.0;         ///< a of Eq 27 [m]
  double semi_minor = 0.0;         ///< b of Eq 27 [m]
  double angle = 0.0;              ///< of the major axis from x, in (-pi/2, pi/2] [rad]
  double semi_major_stddev = 0.0;  ///< from the residuals' scatter [m]
  double semi_minor_stddev = 0.0;  ///< [m]
};

/// A circle fitted to points of a plane. Metres.
struct CircleFit {
  bool valid = false;
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double radius = 0.0;
  double radius_stddev = 0.0;  ///< from the residuals' scatter
};

/// Eq 27 as printed: least squares of the algebraic residual 1 - u^2/a^2 - v^2/b^2, noise not taken
/// into account. Reads too large; for comparison only. Needs six points. Thread-safe.
EllipseFit fitAlgebraicEllipse(const std::vector<Eigen::Vector2d>& points);

/// Least squares of the distance to a circle, noise not taken into account: reads sigma^2 / (2 r)
/// too large in radius. Needs four points. Thread-safe.
CircleFit fitCircle(const std::vector<Eigen::Vector2d>& points);

}  // namespace field_phenotyping
