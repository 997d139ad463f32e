#pragma once

#include <cstdint>
#include <string>

#include "simulation/blade.hpp"
#include "simulation/random.hpp"
#include "simulation/stem.hpp"

namespace field_phenotyping::simulation {

enum class GrowthStage { kSeedling, kJointing, kTasselling, kRipe };

/// @return Lower-case name: seedling, jointing, tasselling or ripe.
std::string stageName(GrowthStage stage);

/// @throws std::invalid_argument Where `name` is none of stageName()'s.
GrowthStage stageFromName(const std::string& name);

/// Settings of the plants, common to the whole field.
struct PlantSettings {
  GrowthStage stage = GrowthStage::kTasselling;
  double mean_height = 0.0;         ///< [m] ground to highest point; 0: the stage's own
  double mean_stem_diameter = 0.0;  ///< [m] major axis; 0: the stage's own
  double size_stddev = 0.06;        ///< between plants, share of the mean
  double lean_stddev_deg = 2.0;     ///< of the lean [deg]; the direction is uniform
  double diameter_height = 0.7;     ///< [m] wished height of the true diameter
};

/// One maize plant: the exact stem and its mesh with labels.
struct MaizePlant {
  std::int32_t id = 0;
  std::int32_t row = 0;
  Stem stem;
  double diameter_height = 0.0;  ///< above the base [m], where the true diameter is taken
  double plant_height = 0.0;     ///< vertical, base to the plant's highest surface point [m]
  std::uint32_t leaf_count = 0;
};

/// @brief Grows one plant and adds its mesh.
///
/// The stem surface, nodes included and up to where the tassel begins, is Part::kStem. Each leaf
/// begins on the stem surface, its foot clasping less than half of it with 0.5 mm of clearance,
/// and is Part::kOrgan throughout: the sheath below is taken as part of the stem surface, as a
/// calliper takes it.
/// @param base Where the stem's axis meets the soil, local map frame [m].
/// @param random The plant's own stream.
MaizePlant growMaizePlant(const PlantSettings& settings, std::int32_t id, std::int32_t row,
                          const Eigen::Vector3d& base, RandomStream random, TriangleMesh& mesh);

/// @throws std::invalid_argument Naming the setting and its range.
void validate(const PlantSettings& settings);

}  // namespace field_phenotyping::simulation
