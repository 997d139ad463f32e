#pragma once

#include <Eigen/Core>
#include <vector>

#include "simulation/mesh.hpp"

namespace field_phenotyping::simulation {

/// A node: the ring where a leaf is inserted and the stem is slightly thicker.
struct StemNode {
  double height = 0.0;    ///< above the base [m]
  double swelling = 0.0;  ///< radius added at the node, as a share of the stem's radius
};

/// @brief Exact stem surface: an elliptic, tapering, gently curved cylinder with nodes.
///
/// Everything is a function of the height `h` above the base (the point where the axis meets the
/// soil), in metres in the local map frame:
///   axis(h) = base + h (tan lean) l + height_ (4 bow u (1 - u) + wave sin 2 pi u), u = h / height
/// so that the chord from base to top has exactly the lean that was drawn. The cross-section in
/// the plane normal to the axis is an ellipse of semi-axes a(h) and b(h) = axis_ratio a(h).
struct Stem {
  Eigen::Vector3d base = Eigen::Vector3d::Zero();
  double height = 1.0;                              ///< vertical, base to top of the stem [m]
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();  ///< tan(lean) times the azimuth's direction
  Eigen::Vector2d bow = Eigen::Vector2d::Zero();    ///< largest bow, as a share of the height
  Eigen::Vector2d wave = Eigen::Vector2d::Zero();   ///< amplitude of the S-bend, same unit
  double reference_semi_major = 0.01;               ///< a, nodes aside, at `reference_height` [m]
  double reference_height = 0.5;                    ///< [m]
  double axis_ratio = 0.9;                          ///< minor / major axis
  double major_azimuth = 0.0;                       ///< of the major axis, from x towards y [rad]
  std::vector<StemNode> nodes;                      ///< upwards

  Eigen::Vector3d axisPoint(double h) const;
  /// @return Unit tangent of the axis, upwards.
  Eigen::Vector3d axisDirection(double h) const;
  /// @return Semi-major axis without the swelling of nodes [m].
  double smoothSemiMajor(double h) const;
  /// @return Semi-major axis of the surface itself [m].
  double semiMajor(double h) const;
  /// @param angle From the major axis towards the minor axis [rad].
  Eigen::Vector3d surfacePoint(double h, double angle) const;
  /// @return Point of the surface at height `h` in the horizontal direction `azimuth` [rad].
  Eigen::Vector3d surfacePointTowards(double h, double azimuth) const;
  /// @return Unit normal of the surface, outwards, the taper neglected.
  Eigen::Vector3d surfaceNormal(double h, double angle) const;
  /// @return Length of the axis from the soil to the top [m].
  double length() const;
  /// @return Signed distance of `point` from the surface [m], positive outside; exact up to the
  /// slope of the taper (0.3 % at nodes). Beyond either end: to the extended surface.
  double signedDistance(const Eigen::Vector3d& point) const;
  /// @return Unit vector from the base to the top of the stem.
  Eigen::Vector3d chordDirection() const;
};

/// @brief Height above the soil at which the true diameter is given [m]: `wished`, or 0.4 of the
/// stem's length where that is lower (short plants).
double diameterHeight(double stem_length, double wished);

/// @brief Adds the stem to the surface begun last, from 3 cm below the soil to its top.
void addStemMesh(const Stem& stem, TriangleMesh& mesh);

/// @brief Samples the stem's surface above the soil on a grid.
/// @param spacing [m] both around and along.
/// @param[out] normals Outward unit normals, one per point.
std::vector<Eigen::Vector3d> sampleStemSurface(const Stem& stem, double spacing,
                                               std::vector<Eigen::Vector3d>& normals);

}  // namespace field_phenotyping::simulation
