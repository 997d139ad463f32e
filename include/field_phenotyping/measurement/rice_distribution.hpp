#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

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

namespace rice {

/// exp(-z) I0(z) and exp(-z) I1(z); polynomials 9.8.1 to 9.8.4 of Abramowitz and Stegun.
FIELD_PHENOTYPING_HD inline void scaledBessel(double z, double& i0, double& i1) {
  if (z < 3.75) {
    const double t = z / 3.75 * (z / 3.75);
    const double decay = exponential(-z);
    i0 = decay *
         (1.0 + t * (3.5156229 +
                     t * (3.0899424 +
                          t * (1.2067492 + t * (0.2659732 + t * (0.0360768 + t * 0.0045813))))));
    i1 =
        decay * z *
        (0.5 + t * (0.87890594 +
                    t * (0.51498869 +
                         t * (0.15084934 + t * (0.02658733 + t * (0.00301532 + t * 0.00032411))))));
    return;
  }
  const double t = 3.75 / z;
  const double scale = 1.0 / std::sqrt(z);
  i0 =
      scale * (0.39894228 +
               t * (0.01328592 +
                    t * (0.00225319 +
                         t * (-0.00157565 +
                              t * (0.00916281 +
                                   t * (-0.02057706 +
                                        t * (0.02635537 + t * (-0.01647633 + t * 0.00392377))))))));
  i1 = scale * (0.39894228 +
                t * (-0.03988024 +
                     t * (-0.00362018 +
                          t * (0.00163801 +
                               t * (-0.01031555 +
                                    t * (0.02282967 + t * (-0.02895312 +
                                                           t * (0.01787654 - t * 0.00420059))))))));
}

/// I1(z) / I0(z) and its derivative.
FIELD_PHENOTYPING_HD inline void besselRatio(double z, double i0, double i1, double& ratio,
                                             double& slope) {
  if (z < 1e-6) {
    ratio = 0.5 * z;
    slope = 0.5;
  } else if (z < 20.0) {
    ratio = i1 / i0;
    slope = 1.0 - ratio / z - ratio * ratio;
  } else {  // asymptotic series: the difference above would lose all digits
    const double t = 1.0 / z;
    ratio = 1.0 - t * (0.5 + t * (0.125 + t * (0.125 + t * 0.1953125)));
    slope = t * t * (0.5 + t * (0.25 + t * (0.375 + t * 0.78125)));
  }
}

}  // namespace rice

/// Distribution of a point's distance from the centre of a circle on which it truly lies, under
/// isotropic Gaussian noise in the plane: p(d) = d/s^2 exp(-(d^2 + r^2)/(2 s^2)) I0(d r/s^2). Its
/// mean is above r by s^2/(2r) and more: what a least-squares circle reads too large.
///
/// @param distance d > 0, @param radius r > 0, @param noise s > 0: standard deviation along one
///        axis; any common unit. Relative error below 1e-6. Thread-safe.
FIELD_PHENOTYPING_HD inline RiceTerms riceTerms(double distance, double radius, double noise) {
  const double precision = 1.0 / (noise * noise);
  const double z = distance * radius * precision;
  double i0 = 1.0;
  double i1 = 0.0;
  rice::scaledBessel(z, i0, i1);
  double ratio = 0.0;
  double slope = 0.0;
  rice::besselRatio(z, i0, i1, ratio, slope);
  const double pull = precision * ratio;
  const double d = distance;
  const double r = radius;

  RiceTerms terms;
  terms.value = logarithm(d * precision * i0) - 0.5 * (d - r) * (d - r) * precision;
  terms.by_distance = 1.0 / d - d * precision + r * pull;
  terms.by_radius = -r * precision + d * pull;
  terms.by_log_noise = -2.0 + (d * d + r * r) * precision - 2.0 * z * ratio;
  terms.by_distance2 = -1.0 / (d * d) - precision + r * precision * r * precision * slope;
  terms.by_radius2 = -precision + d * precision * d * precision * slope;
  terms.by_distance_radius = pull + z * precision * slope;
  terms.by_distance_noise = 2.0 * (d * precision - r * pull - z * r * precision * slope);
  terms.by_radius_noise = 2.0 * (r * precision - d * pull - z * d * precision * slope);
  terms.by_log_noise2 = -2.0 * (d * d + r * r) * precision + 4.0 * z * ratio + 4.0 * z * z * slope;
  return terms;
}

}  // namespace field_phenotyping
