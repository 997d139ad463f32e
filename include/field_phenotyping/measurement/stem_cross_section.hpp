#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"

namespace field_phenotyping {

/// What is known of a stem before its points are looked at.
struct CrossSectionPrior {
  double noise = 0.0;  ///< of a point across the stem, one axis [m]; 0: estimated
  Trait log_noise;     ///< logarithm of that, where estimated; NaN: hardly anything is known
  /// Of the noise: logarithm of its standard deviation along the surface's normal over `noise`,
  /// which is the geometric mean of that and of the one along the surface. Hardly to be told from
  /// one stem, but thick noise along the surface makes it look larger.
  Trait elongation{0.0, 0.05};
  Trait radius;  ///< (a + b) / 2 at height 0 [m]; NaN: from the width of the points
  double radius_alike_stddev = 0.0;  ///< of what errors of that all stems share [m]; no fit knows
                                     ///< of it: results have it as far as the priors decide them
  double ellipticity_stddev = 0.05;  ///< of each component of (a - b) / (a + b); 0: a circle
  Trait taper{-0.15, 0.25};          ///< relative change of radius with height [1/m]
  Trait taper_change{0.0, 0.2};      ///< relative change with the square of height [1/m^2]
};

/// Cross-section of a piece of stem, as fitted by fitStemCrossSection(). Metres, radians; x
/// and y lie across the reference axis, heights along it.
///
/// The surface at height h is center + h tilt + h^2 curvature + h^3 twist + (S + (h taper + h^2
/// taper_change) radius I) u(t), where u(t) = (cos t, sin t) and S is symmetric with the
/// eigenvalues a and b.
struct StemCrossSection {
  bool valid = false;
  bool converged = false;
  Eigen::Vector2d center = Eigen::Vector2d::Zero();     ///< at height 0 [m]
  Eigen::Vector2d tilt = Eigen::Vector2d::Zero();       ///< of the true axis from the reference
  Eigen::Vector2d curvature = Eigen::Vector2d::Zero();  ///< [1/m]
  Eigen::Vector2d twist = Eigen::Vector2d::Zero();      ///< [1/m^2]
  Trait radius;                                         ///< (a + b) / 2 at height 0 [m]
  Trait taper;         ///< change of radius with height, relative to `radius` [1/m]
  Trait taper_change;  ///< the same, with the square of height [1/m^2]
  Eigen::Vector2d ellipticity = Eigen::Vector2d::Zero();  ///< (a - b) / (a + b) at twice its angle
  double ellipticity_stddev = 0.0;                        ///< of each component
  Trait major;                 ///< 2a at height 0 [m]: posterior mean and standard deviation
  Trait minor;                 ///< 2b [m]
  Trait equivalent;            ///< 2 sqrt(a b) [m]
  double major_angle = 0.0;    ///< of the major axis from x, in (-pi/2, pi/2]
  double noise = 0.0;          ///< standard deviation of a point, one axis [m]
  Trait log_noise;             ///< its logarithm
  double outlier_share = 0.0;  ///< of points that are not of the stem's surface
  double points = 0.0;         ///< expected number of points of the stem's surface
  double arc_coverage = 0.0;   ///< share of the circumference with points
  double prior_share = 0.0;    ///< of the priors in what is known of 2a, in [0, 1]
  double ellipticity_prior_share = 0.0;  ///< likewise of the ellipticity
};

/// Maximum-likelihood fit of a tapering, elliptic, gently curved cylinder (paper 2.8, default
/// mode).
///
/// Each point is a point of the surface plus Gaussian noise across the axis, or an outlier spread
/// evenly over the disc that holds all points. Noise along the surface moves points outwards, by
/// about s^2/(2 r), and blurs the ends of a half-seen arc; both are part of the model. How many
/// points lie where round the stem is found with the shape (surface_mixture.hpp), so that unseen
/// sides are no evidence. The noise is found by residual maximum likelihood, for shape and places.
/// The covariance is the inverse of the observed information (Louis 1982), with the shares of the
/// sides integrated out; it is never less than the Kanatani-Cramer-Rao bound, and widened where
/// patches of the surface disagree by more, for arcs of half of a stem and more for shorter ones,
/// and for what is not known of the noise along the surface. Where patches disagree by far more
/// than chance, points count for less than one in the fit itself: thousands of points of a surface
/// that is no ellipse do not outweigh what is known of stems.
///
/// Priors keep sparse and half-seen stems sane: those of `prior`, weak ones by default, and weak
/// ones on tilt, curvature and twist. As the larger of two noisy semi-axes reads too large, `major`
/// is the posterior mean of 2a. Where the noise is above 0.6 of the radius only a circle is fitted,
/// and the ellipticity is what the prior says.
///
/// @param points (x, y, height): x, y across the reference axis [m], which need not be centred or
///        well aligned; height along it [m], 0 where the cross-section is wanted
/// @param near where to begin: a fit of nearly the same points or with another prior. Where it is
///        not to be trusted, as of stems half of which is not seen, the fit looks for a start
///        itself
/// @return invalid for fewer than five points or where no finite solution is found
/// Thread-safe, deterministic; the order of the points does not matter beyond rounding.
StemCrossSection fitStemCrossSection(const std::vector<Eigen::Vector3d>& points,
                                     const CrossSectionPrior& prior,
                                     const StemCrossSection& near = StemCrossSection());

/// A piece of stem to be fitted: what fitStemCrossSection() is given.
struct StemPiece {
  std::vector<Eigen::Vector3d> points;
  CrossSectionPrior prior;
  StemCrossSection near;
};

/// fitStemCrossSection() of many pieces, on several cores, or all at once on a GPU: the results are
/// the same. Thread-safe, deterministic.
std::vector<StemCrossSection> fitStemCrossSections(const std::vector<StemPiece>& pieces,
                                                   const ComputeDevice& device);

}  // namespace field_phenotyping
