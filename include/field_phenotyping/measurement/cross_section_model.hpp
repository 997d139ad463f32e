#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {

/// The parameters of a piece of stem as its fits solve for them. Metres; x and y lie across the
/// reference axis, heights along it. The surface is that of StemCrossSection, with S = r I + [c s;
/// s -c]; ellipticity, taper and its change are not divided by the radius here.
enum CrossSectionIndex {
  kCenter = 0,        ///< x, y [m]
  kTilt = 2,          ///< change of the center with height
  kCurvature = 4,     ///< with the square of height [1/m]
  kTwist = 6,         ///< with its cube [1/m^2]
  kRadius = 8,        ///< r [m]
  kTaper = 9,         ///< its change with height
  kTaperChange = 10,  ///< with the square of height [1/m]
  kEllipse = 11,      ///< c, s [m]
  kNoise = 13,        ///< logarithm of the noise [log m]
  kElongation = 14    ///< of the noise: logarithm of its part along the normal over that
};
constexpr int kCrossSectionSize = 15;
using CrossSectionVector = Eigen::Matrix<double, kCrossSectionSize, 1>;
using CrossSectionMatrix = Eigen::Matrix<double, kCrossSectionSize, kCrossSectionSize>;

/// Noise below this share of the radius is not told from none.
constexpr double kLeastBlur = 1e-3;

Eigen::Vector2d centerAt(const CrossSectionVector& parameters, double height);
/// At least a tenth of that at height 0, whatever the taper.
double radiusAt(const CrossSectionVector& parameters, double height);

/// How far a place of the surface moves along a direction by a shift in x and y, by the radius, and
/// by the two components of ellipticity.
using SurfaceMotion = Eigen::Matrix<double, 5, 1>;
/// @param u the place, as the unit vector of its parameter
SurfaceMotion surfaceMotion(const Eigen::Vector2d& u, const Eigen::Vector2d& direction);

/// Keeps a step within what a local quadratic model can be trusted for.
void limitStep(const CrossSectionVector& parameters, CrossSectionVector& step);

/// What the points of a piece of stem look like before anything is fitted.
struct StemExtent {
  double reach = 0.0;           ///< largest distance from the reference axis [m]
  double width_variance = 0.0;  ///< across the stem, in the direction in which it is largest [m^2]
};
StemExtent extentOf(const std::vector<Eigen::Vector3d>& points);

/// The priors as independent normal distributions, those that scale with the stem at its present
/// size.
struct ParameterPrior {
  CrossSectionVector mean = CrossSectionVector::Zero();
  CrossSectionVector weight = CrossSectionVector::Zero();  ///< inverse variances

  ParameterPrior() = default;
  ParameterPrior(const CrossSectionPrior& prior, const StemExtent& extent,
                 const CrossSectionVector& parameters);
};

}  // namespace field_phenotyping
