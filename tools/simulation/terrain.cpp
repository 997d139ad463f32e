#include "simulation/terrain.hpp"

#include <cmath>
#include <stdexcept>

#include "simulation/random.hpp"

namespace field_phenotyping::simulation {

Terrain::Terrain(const TerrainSettings& settings, double row_azimuth, double row_spacing,
                 std::uint64_t seed)
    : across_rows_(-std::sin(row_azimuth), std::cos(row_azimuth)),
      row_spacing_(row_spacing),
      ridge_height_(settings.ridge_height),
      roughness_(settings.roughness) {
  const double azimuth = settings.slope_azimuth_deg * M_PI / 180.0;
  gradient_ = std::tan(settings.slope_deg * M_PI / 180.0) *
              Eigen::Vector2d(std::cos(azimuth), std::sin(azimuth));
  if (roughness_ > 0.0) {
    // A sum of random waves with normal wave numbers has a Gaussian correlation.
    constexpr int kWaves = 48;
    RandomStream random(seed, Stream::kTerrain, 0);
    for (int i = 0; i < kWaves; ++i) {
      Wave wave;
      wave.number.x() = random.normal(0.0, 1.0) / settings.roughness_correlation;
      wave.number.y() = random.normal(0.0, 1.0) / settings.roughness_correlation;
      wave.phase = random.uniform(0.0, 2.0 * M_PI);
      waves_.push_back(wave);
    }
  }
}

double Terrain::height(const Eigen::Vector2d& position) const {
  double z = slopeHeight(position);
  z += 0.5 * ridge_height_ * std::cos(2.0 * M_PI * across_rows_.dot(position) / row_spacing_);
  double sum = 0.0;
  for (const Wave& wave : waves_) {
    sum += std::cos(wave.number.dot(position) + wave.phase);
  }
  return waves_.empty()
             ? z
             : z + roughness_ * std::sqrt(2.0 / static_cast<double>(waves_.size())) * sum;
}

double Terrain::cellSize() const {
  const bool plane = ridge_height_ == 0.0 && waves_.empty();
  return plane ? 0.25 : 0.03;
}

void validate(const TerrainSettings& settings) {
  const auto require = [](bool ok, const char* message) {
    if (!ok) {
      throw std::invalid_argument(message);
    }
  };
  require(settings.slope_deg >= 0.0 && settings.slope_deg <= 45.0, "the slope must be 0 to 45 deg");
  require(settings.ridge_height >= 0.0 && settings.ridge_height <= 0.5,
          "the ridge height must be 0 to 0.5 m");
  require(settings.roughness >= 0.0 && settings.roughness <= 0.1,
          "the roughness must be 0 to 0.1 m");
  require(settings.roughness_correlation >= 0.05 && settings.roughness_correlation <= 5.0,
          "the correlation length of the roughness must be 0.05 to 5 m");
}

}  // namespace field_phenotyping::simulation
