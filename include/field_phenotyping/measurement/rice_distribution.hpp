#pragma once

namespace field_phenotyping {

/// Logarithm of the Rice density and its derivatives.
struct RiceTerms {
  double value = 0.0;
  double by_distance = 0.0;
  double by_radius = 0.0;
  double by_log_noise = 0.0;
  double by_distance2 = 0.0;
  double by_radius2 = 0.0;
  double by_log_noise2 = 0.0;
  double by_distance_radius = 0.0;
  double by_distance_noise = 0.0;
  double by_radius_noise = 0.0;
};

/// Distribution of a point's distance from the centre of a circle on which it truly lies, under
/// isotropic Gaussian noise in the plane: p(d) = d/s^2 exp(-(d^2 + r^2)/(2 s^2)) I0(d r/s^2). Its
/// mean is above r by s^2/(2r) and more: what a least-squares circle reads too large.
///
/// @param distance d > 0, @param radius r > 0, @param noise s > 0: standard deviation along one
///        axis; any common unit. Relative error below 1e-6. Thread-safe.
RiceTerms riceTerms(double distance, double radius, double noise);

}  // namespace field_phenotyping
