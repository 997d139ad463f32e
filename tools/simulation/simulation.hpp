#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "simulation/field.hpp"
#include "simulation/lidar.hpp"
#include "simulation/trajectory.hpp"

namespace field_phenotyping::simulation {

/// Everything that determines a simulation.
struct SimulationSettings {
  std::uint64_t seed = 1;
  std::uint64_t target_points = 900000;  ///< size of the merged cloud; 0: as the speed gives it
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< of the local frame, in the map [m]
  FieldSettings field;
  RoverSettings rover;  ///< `speed` is lowered where target_points asks for it
  LidarSettings lidar;
};

/// Truth of one plant beside what of it is in the cloud. Metres and radians, map frame.
struct PlantTruth {
  std::int32_t plant_id = 0;
  std::int32_t row = 0;
  Eigen::Vector3d base = Eigen::Vector3d::Zero();  ///< where the stem's axis meets the soil
  double height = 0.0;                             ///< vertical, base to the highest surface point
  double stem_diameter = 0.0;        ///< major axis at diameter_height; a node's swelling left out
  double stem_diameter_minor = 0.0;  ///< minor axis there
  double diameter_height = 0.0;      ///< vertical, above the base
  double stem_length = 0.0;          ///< along the axis, soil to tassel
  double lean = 0.0;                 ///< of the chord from the base to the stem's top
  double lean_azimuth = 0.0;         ///< of that chord, from x towards y
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< direction of that chord
  std::uint64_t visible_points = 0;
  std::uint64_t visible_stem_points = 0;
  double highest_visible_z = 0.0;  ///< of the plant's points in the cloud; NaN without any
};

/// A simulated field with the scans that were taken of it.
struct Simulation {
  SimulationSettings settings;  ///< with the speed that was driven
  std::unique_ptr<const Field> field;
  std::unique_ptr<const RayCaster> caster;
  std::unique_ptr<const Trajectory> trajectory;
  std::unique_ptr<const Lidar> lidar;
  std::vector<Scan> scans;

  std::uint64_t pointCount() const;
  std::vector<PlantTruth> truth() const;
};

/// Called with a step's name and the share of it that is done, from one thread at a time.
using ProgressCallback = std::function<void(const char* step, double share)>;

/// @brief Grows the field and drives the LiDAR through it.
///
/// Deterministic in `settings`, whatever the number of threads.
/// With `target_points` the rover slows down where needed for 4 % more points than asked for, by
/// the share of pulses that return, counted on a sparse sample; the surplus is removed at random,
/// as a front end does that hands on a thinned map.
/// @throws std::invalid_argument On a setting out of its range.
/// @throws std::runtime_error When the sensor sees nothing at all, or `target_points` are far too
/// many for the field.
Simulation simulate(const SimulationSettings& settings, const ProgressCallback& progress);

}  // namespace field_phenotyping::simulation
