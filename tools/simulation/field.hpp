#pragma once

#include <cstdint>
#include <vector>

#include "simulation/maize_plant.hpp"
#include "simulation/mesh.hpp"
#include "simulation/terrain.hpp"

namespace field_phenotyping::simulation {

/// Settings of the field. Metres unless said otherwise.
struct FieldSettings {
  std::int32_t rows = 4;
  std::int32_t plants_per_row = 30;  ///< 0: no maize; the plot is then `bare_length` long
  double row_spacing = 0.75;
  double plant_spacing = 0.20;
  double position_stddev = 0.015;  ///< of each base along and across its row
  double missing_share = 0.0;      ///< of the plants, [0, 1)
  double row_azimuth_deg = 0.0;    ///< direction of the rows, anticlockwise from the map's x [deg]
  double bare_length = 6.0;        ///< length of the plot when plants_per_row is 0
  std::int32_t weeds = 0;          ///< placed at random over the plot
  PlantSettings plant;
  TerrainSettings terrain;
};

/// @brief A field: plants, soil and weeds as one labelled mesh, and the exact plants.
///
/// Local map frame: the nominal place of the first plant of the first row is the origin (there
/// z = 0 is the height of the slope); rows run along `row_azimuth`, the next row is to their left.
struct Field {
  FieldSettings settings;
  Terrain terrain;
  std::vector<MaizePlant> plants;  ///< by id: 0, 1, ... row by row, missing ones not counted
  TriangleMesh mesh;
  double length = 0.0;  ///< of the plot along the rows, first to last plant
  double width = 0.0;   ///< first to last row

  /// @return Local map position of a place `along` the rows and `across` them [m].
  Eigen::Vector2d position(double along, double across) const;
};

/// Soil reaches this far beyond the outermost plants [m].
constexpr double kFieldBorder = 1.0;

/// @brief Grows a field. Deterministic in (settings, seed).
/// @throws std::invalid_argument Naming the setting and its range.
Field growField(const FieldSettings& settings, std::uint64_t seed);

}  // namespace field_phenotyping::simulation
