#pragma once

#include <Eigen/Core>
#include <array>
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

/// What a point's likelihood depends on: how far its place of the surface moves (SurfaceMotion, in
/// its order), the noise and its elongation, as in CrossSectionIndex.
enum LocalIndex { kLocalNoise = 5, kLocalElongation = 6 };
constexpr int kLocalShapeSize = 5;
constexpr int kLocalSize = 7;
using LocalVector = Eigen::Matrix<double, kLocalSize, 1>;

/// Which local quantity a parameter moves, and with which power of height.
struct ParameterEffect {
  int local;
  int power;
};
constexpr std::array<ParameterEffect, kCrossSectionSize> kParameterEffects = {
    {{0, 0},
     {1, 0},
     {0, 1},
     {1, 1},
     {0, 2},
     {1, 2},
     {0, 3},
     {1, 3},
     {2, 0},
     {2, 1},
     {2, 2},
     {3, 0},
     {4, 0},
     {kLocalNoise, 0},
     {kLocalElongation, 0}}};

/// Powers of height that products of two parameters go with, and one more to fill lanes.
constexpr int kHeightPowers = 8;
using HeightPowers = Eigen::Matrix<double, kHeightPowers, 1>;
HeightPowers heightPowers(double height);

/// Derivatives by the parameters of what a point at that height says, from those by the local
/// quantities.
CrossSectionVector spread(const LocalVector& local, const HeightPowers& powers);

/// A symmetric matrix over the local quantities: its lower half, row by row.
constexpr int kLocalPairs = kLocalSize * (kLocalSize + 1) / 2;
using LocalPairs = Eigen::Matrix<double, kLocalPairs, 1>;
constexpr int localPair(int a, int b) {
  return a < b ? localPair(b, a) : a * (a + 1) / 2 + b;
}

/// Second derivatives by the parameters, summed over points: those by the local quantities meet the
/// powers of height only once.
class HeightSums {
 public:
  void add(const LocalPairs& local, const HeightPowers& powers) {
    sums_.noalias() += powers * local.transpose();
  }
  CrossSectionMatrix total() const;

 private:
  Eigen::Matrix<double, kHeightPowers, kLocalPairs> sums_ =
      Eigen::Matrix<double, kHeightPowers, kLocalPairs>::Zero();
};

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
