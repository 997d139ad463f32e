#include "simulation/field.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "simulation/weed.hpp"

namespace field_phenotyping::simulation {
namespace {

void validate(const FieldSettings& settings) {
  const auto require = [](bool ok, const char* message) {
    if (!ok) {
      throw std::invalid_argument(message);
    }
  };
  require(settings.rows >= 1,
          "the field needs at least 1 row; for a bare field set the plants "
          "per row to 0");
  require(settings.plants_per_row >= 0, "the plants per row must not be negative");
  require(settings.row_spacing >= 0.1, "the row spacing must be at least 0.1 m");
  require(settings.plant_spacing >= 0.02, "the plant spacing must be at least 0.02 m");
  require(settings.position_stddev >= 0.0, "the spread of positions must not be negative");
  require(settings.missing_share >= 0.0 && settings.missing_share < 1.0,
          "the share of missing plants must be at least 0 and less than 1");
  require(settings.bare_length > 0.0, "the length of a bare plot must be above 0 m");
  require(settings.weeds >= 0, "the number of weeds must not be negative");
  validate(settings.plant);
  validate(settings.terrain);
}

Eigen::Vector3d onSoil(const Terrain& terrain, const Eigen::Vector2d& position) {
  return {position.x(), position.y(), terrain.height(position)};
}

void addSoil(Field& field) {
  constexpr float kReflectance = 0.30F;
  field.mesh.beginSurface({-1, Part::kGround, kReflectance});
  const double length = field.length + 2.0 * kFieldBorder;
  const double width = field.width + 2.0 * kFieldBorder;
  const double cell = field.terrain.cellSize();
  const auto columns = static_cast<std::size_t>(std::ceil(length / cell)) + 1;
  const auto rows = static_cast<std::size_t>(std::ceil(width / cell)) + 1;
  const auto first = static_cast<std::uint32_t>(field.mesh.vertices.size());
  for (std::size_t row = 0; row < rows; ++row) {
    const double across =
        -kFieldBorder + width * static_cast<double>(row) / static_cast<double>(rows - 1);
    for (std::size_t column = 0; column < columns; ++column) {
      const double along =
          -kFieldBorder + length * static_cast<double>(column) / static_cast<double>(columns - 1);
      field.mesh.addVertex(onSoil(field.terrain, field.position(along, across)));
    }
  }
  field.mesh.addGrid(first, rows, columns, false);
}

void addPlants(std::uint64_t seed, Field& field) {
  const FieldSettings& settings = field.settings;
  std::int32_t id = 0;
  for (std::int32_t row = 0; row < settings.rows; ++row) {
    for (std::int32_t i = 0; i < settings.plants_per_row; ++i) {
      const auto place = static_cast<std::uint64_t>(row) * 1000000U + static_cast<std::uint64_t>(i);
      RandomStream layout(seed, Stream::kLayout, place);
      const bool missing = layout.uniform() < settings.missing_share;
      const double along =
          settings.plant_spacing * i + layout.normal(0.0, settings.position_stddev);
      const double across =
          settings.row_spacing * row + layout.normal(0.0, settings.position_stddev);
      if (missing) {
        continue;
      }
      const Eigen::Vector3d base = onSoil(field.terrain, field.position(along, across));
      field.plants.push_back(growMaizePlant(settings.plant, id, row, base,
                                            RandomStream(seed, Stream::kPlant, place), field.mesh));
      ++id;
    }
  }
}

void addWeeds(std::uint64_t seed, Field& field) {
  const double margin = std::min(0.5 * field.settings.row_spacing, 0.5 * kFieldBorder);
  for (std::int32_t i = 0; i < field.settings.weeds; ++i) {
    RandomStream random(seed, Stream::kWeed, static_cast<std::uint64_t>(i));
    const double along = random.uniform(-margin, field.length + margin);
    const double across = random.uniform(-margin, field.width + margin);
    addWeed(onSoil(field.terrain, field.position(along, across)), random, field.mesh);
  }
}

}  // namespace

Eigen::Vector2d Field::position(double along, double across) const {
  const double azimuth = settings.row_azimuth_deg * M_PI / 180.0;
  const Eigen::Vector2d direction(std::cos(azimuth), std::sin(azimuth));
  return along * direction + across * Eigen::Vector2d(-direction.y(), direction.x());
}

Field growField(const FieldSettings& settings, std::uint64_t seed) {
  validate(settings);
  const double azimuth = settings.row_azimuth_deg * M_PI / 180.0;
  Field field{settings, Terrain(settings.terrain, azimuth, settings.row_spacing, seed), {}, {}};
  field.length = settings.plants_per_row > 0
                     ? settings.plant_spacing * (settings.plants_per_row - 1)
                     : settings.bare_length;
  field.width = settings.row_spacing * (settings.rows - 1);
  addSoil(field);
  addPlants(seed, field);
  addWeeds(seed, field);
  return field;
}

}  // namespace field_phenotyping::simulation
