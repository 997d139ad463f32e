#pragma once

#include <Eigen/Core>
#include <vector>

#include "gappy_stems.hpp"

namespace field_phenotyping::benchmark {

/// A stem with its gaps filled by some method. Local frame of the stem's cloud [m].
struct FilledStem {
  std::vector<Eigen::Vector3f> measured;  ///< as the method left them
  std::vector<Eigen::Vector3f> filled;    ///< points that it made
  std::vector<float> stddev;              ///< of each filled point, where the method says one [m]
  double seconds = 0.0;                   ///< of one core
};

/// The three figures of Table 2 of the paper.
struct CloudScore {
  double completeness = 0.0;  ///< PC: share of the true surface with a point within 5 mm
  double smoothness = 0.0;    ///< SM: mean |cos| between a point's normal and its 12 neighbours'
  double resolution =
      0.0;  ///< RD: share of 1 cm cells whose density is within a factor 2 of `density`
};

/// @param density that was asked for [1/m^2]
CloudScore scoreCloud(const std::vector<Eigen::Vector3f>& points, const TrueSurface& truth,
                      double density);

/// Distances of filled points from the true surface.
struct SurfaceErrors {
  std::size_t points = 0U;   ///< of which the distance is known
  double squares = 0.0;      ///< [m^2] sum
  double sum = 0.0;          ///< [m] positive outside
  std::size_t covered = 0U;  ///< within 1.96 of their own standard deviations
};

SurfaceErrors surfaceErrors(const FilledStem& stem, const TrueSurface& truth);

}  // namespace field_phenotyping::benchmark
