#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping::benchmark {

/// How pieces of stem are made and seen. Metres, radians.
struct PieceSettings {
  std::uint64_t seed = 1U;
  double diameter = 0.020;        ///< 2a at the middle
  double least_axis_ratio = 0.8;  ///< b / a is drawn evenly between this ...
  double most_axis_ratio = 1.0;   ///< ... and this
  double noise = 0.003;           ///< standard deviation in x and in y
  int points = 300;
  double arc = 6.283185307179586;  ///< angle round the stem that is seen, points evenly on it
  double span = 0.4;               ///< length of stem
  double outlier_share = 0.0;      ///< of points of a leaf that leaves the stem
};

/// A straight, tapering, elliptic piece of stem as a sensor sees it, and the truth about it.
///
/// (x, y, height) lie across and along a reference axis that is some millimetres and degrees off,
/// as a segmentation gives it; height 0 is the middle.
struct StemPiece {
  std::vector<Eigen::Vector3d> points;  ///< as measured [m]
  std::vector<Eigen::Vector2d> feet;    ///< (angle t, height) of each on the surface; NaN: outlier
  double major = 0.0;                   ///< 2a [m]
  double minor = 0.0;                   ///< 2b [m]
  double azimuth = 0.0;                 ///< of the major axis [rad]
};

/// Piece number `index` of a series; its truth and its noise are functions of seed and number.
StemPiece drawStemPiece(const PieceSettings& settings, int index);

/// Cramer-Rao bound of the standard deviation of 2a [m], for the model that
/// fitStemCrossSection() fits with unknown noise.
///
/// The information that a point carries about a shift and a growth of the surface and about the
/// noise is the mean square of the scores of its Rice distribution, by quadrature; the priors of
/// the model on ellipticity, taper, tilt and curvature are information too (van Trees' form).
/// @param feet angle t round the section's centre from the major axis [rad] and height [m] of the
///        surface point of every measured point; NaN is skipped
double cramerRaoBound(const std::vector<Eigen::Vector2d>& feet, double major, double minor,
                      double noise, const CrossSectionPrior& prior);

}  // namespace field_phenotyping::benchmark
