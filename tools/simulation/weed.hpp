#pragma once

#include <Eigen/Core>

#include "simulation/mesh.hpp"
#include "simulation/random.hpp"

namespace field_phenotyping::simulation {

/// @brief Adds one weed, 5 to 25 cm high: a broad-leaved rosette or a tuft of grass.
///
/// Its surface is labelled Part::kGround with plant_id -1.
/// @param base On the soil, local map frame [m].
void addWeed(const Eigen::Vector3d& base, RandomStream random, TriangleMesh& mesh);

}  // namespace field_phenotyping::simulation
