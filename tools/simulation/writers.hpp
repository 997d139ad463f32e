#pragma once

#include <string>

#include "simulation/simulation.hpp"

namespace field_phenotyping::simulation {

/// @return Whether map coordinates this large (over 1000 m) need double precision in files:
/// float32 resolves 0.06 mm at 1000 m but only 0.5 m at UTM northings.
bool needsDoublePrecision(const Eigen::Vector3d& origin);

/// @brief Writes the merged cloud, binary PCD in the map frame, points in the order of the scans.
///
/// Fields x y z (float32; float64 where needsDoublePrecision) plant_id (int32, -1: none),
/// part (uint8: 0 ground or weed, 1 stem, 2 other organ), intensity (float32, 0-255).
/// @throws std::runtime_error When the file cannot be written.
void writeCloud(const Simulation& simulation, const std::string& path);

/// @brief Writes the true stem surfaces above the soil, sampled every 2 mm, as binary PCD in the
/// map frame: x y z normal_x normal_y normal_z plant_id.
/// @throws std::runtime_error When the file cannot be written.
void writeStemSurface(const Simulation& simulation, const std::string& path);

/// @brief Writes one line per plant (see PlantTruth) as CSV: metres and radians, map frame.
/// @throws std::runtime_error When the file cannot be written.
void writeTruth(const Simulation& simulation, const std::string& path);

/// @brief Writes the sensor's pose in the map frame and the number of points of each scan as CSV:
/// scan,time,x,y,z,qx,qy,qz,qw,points.
/// @throws std::runtime_error When the file cannot be written.
void writeTrajectory(const Simulation& simulation, double start_time, const std::string& path);

}  // namespace field_phenotyping::simulation
