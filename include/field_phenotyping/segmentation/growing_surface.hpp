#pragma once

#include <Eigen/Core>
#include <vector>

namespace field_phenotyping {

/// Where a point lies about a midline.
struct SurfaceSighting {
  float azimuth = 0.0F;    ///< from x towards y [rad]
  float departure = 0.0F;  ///< beyond the midline's radius, share of it; without noise's bias
};

/// The surface of a stem, completed while the stem grows (paper 2.6.1): each region that grows
/// brings it up to date, and what it expects further up says whether the next region goes on from
/// those below.
///
/// The departure of r(theta, s) from the midline's radius, in shares of it, is interpolated by its
/// mean, shift and ellipse, which wander along the stem: a Kalman filter from the base up, that is
/// a Gaussian process with an exponential kernel along s. It begins as the coarse model that the
/// start points gave, the midline itself. Not thread-safe.
class GrowingSurface {
 public:
  /// @param noise standard deviation of points about the surface, share of the radius
  explicit GrowingSurface(float noise);

  /// Carries the state up the stem. @param by arc length [m], >= 0
  void advance(float by);
  /// Takes in points round the place that was advanced to; those far off the surface are left out.
  void update(const std::vector<SurfaceSighting>& points);

  /// Logarithm of how much likelier points round that place are to lie on the expected surface than
  /// anywhere within reach of it, as what crosses the axis by chance does. 0 for no points.
  float evidence(const std::vector<SurfaceSighting>& points) const;

  /// Longest gap along a stem of that radius [m] that its surface carries across [m]: as long as
  /// where it goes on, free to bend, still overlaps with where it was heading.
  static float longestCarried(float radius);

 private:
  static constexpr int kTerms = 5;  // mean; cosine and sine of theta; of 2 theta
  using Terms = Eigen::Matrix<double, kTerms, 1>;
  using Covariance = Eigen::Matrix<double, kTerms, kTerms>;

  /// How a point compares with the expected surface.
  struct Residual {
    Terms terms;
    double off = 0.0;       // beyond it
    double variance = 0.0;  // of that, as expected
  };
  Residual residualOf(const SurfaceSighting& point) const;

  double noise_;
  Terms state_;
  Covariance covariance_;
};

}  // namespace field_phenotyping
