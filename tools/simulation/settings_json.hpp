#pragma once

#include <string>

#include "simulation/simulation.hpp"

namespace field_phenotyping::simulation {

/// @brief Writes all settings and the totals of a simulation as JSON; units are in the names.
/// @throws std::runtime_error When the file cannot be written.
void writeSettings(const Simulation& simulation, const std::string& path);

}  // namespace field_phenotyping::simulation
