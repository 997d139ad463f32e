#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "simulation/mesh.hpp"

namespace field_phenotyping::simulation {

/// Settings of the soil surface. Lengths in metres.
struct TerrainSettings {
  double slope_deg = 0.0;               ///< steepest slope [deg]
  double slope_azimuth_deg = 0.0;       ///< uphill direction, anticlockwise from the map's x [deg]
  double ridge_height = 0.0;            ///< crest to furrow; a crest under each row
  double roughness = 0.005;             ///< standard deviation of the height
  double roughness_correlation = 0.15;  ///< length over which roughness is alike
};

/// Height of the soil as an exact function of the horizontal position, in the local map frame.
class Terrain {
 public:
  /// @param row_azimuth Direction of the rows, from x towards y [rad].
  /// @param row_spacing Distance between crests [m].
  Terrain(const TerrainSettings& settings, double row_azimuth, double row_spacing,
          std::uint64_t seed);

  /// @return Height of the soil [m].
  double height(const Eigen::Vector2d& position) const;

  /// @return Height of the slope alone, without ridges and roughness [m].
  double slopeHeight(const Eigen::Vector2d& position) const { return gradient_.dot(position); }

  /// @return Edge of the mesh's cells that keeps it within about 0.3 mm of height() [m].
  double cellSize() const;

 private:
  struct Wave {
    Eigen::Vector2d number;  // [rad/m]
    double phase;
  };
  Eigen::Vector2d gradient_;
  Eigen::Vector2d across_rows_;
  double row_spacing_;
  double ridge_height_;
  double roughness_;
  std::vector<Wave> waves_;
};

/// @throws std::invalid_argument Naming the setting and its range.
void validate(const TerrainSettings& settings);

}  // namespace field_phenotyping::simulation
