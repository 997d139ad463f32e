#pragma once

#include <Eigen/Core>
#include <vector>

#include "simulation/mesh.hpp"

namespace field_phenotyping::simulation {

/// A leaf blade: a midrib that rises and droops in a slowly turning vertical plane, with a
/// trough-shaped, tapering cross-section. Metres and radians.
struct Blade {
  Eigen::Vector3d start = Eigen::Vector3d::Zero();  ///< where the midrib leaves the stem
  double azimuth = 0.0;                             ///< of the midrib's plane, from x towards y
  double azimuth_drift = 0.0;                       ///< turned by this much at the tip
  double length = 0.7;                              ///< along the midrib
  double width = 0.08;                              ///< widest
  double insertion_angle = 0.5;                     ///< of the midrib from vertical at the start
  double tip_angle = 2.2;                           ///< of the midrib from vertical at the tip
  double droop_exponent = 1.6;                      ///< larger: straight for longer, then bends
  double clasp_radius = 0.012;  ///< the blade's foot is curved round a stem of this radius
  double trough_angle = 0.3;    ///< between each half of the blade and the flat
  double roll = 0.0;            ///< of the tip about the midrib
  double ripple = 0.005;        ///< amplitude of the wavy margin
  double ripple_phase = 0.0;
};

/// @brief Adds a blade to the surface begun last.
void addBladeMesh(const Blade& blade, TriangleMesh& mesh);

/// @brief Adds a round tube along a polyline to the surface begun last; open at both ends.
/// @param radii [m] one per point of `centreline`; at least two points.
void addTubeMesh(const std::vector<Eigen::Vector3d>& centreline, const std::vector<double>& radii,
                 int sides, TriangleMesh& mesh);

}  // namespace field_phenotyping::simulation
