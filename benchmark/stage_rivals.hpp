#pragma once

#include <functional>
#include <nlohmann/json.hpp>

#include "field_phenotyping/common/point_cloud.hpp"

namespace field_phenotyping::benchmark {

/// How stages are timed beside the Point Cloud Library.
struct StageTiming {
  int repeats = 3;
  int every_stem = 4;  ///< of the stems only every so many-th is completed
  std::function<void(double)> progress;
};

/// Times stages and what the Point Cloud Library has for the same work, in turn and on the same
/// points. One row for each: stage, method, points (given), found (points, or regions), seconds
/// (of every run).
nlohmann::json timeStages(const PointCloud& cloud, const StageTiming& timing);

/// Counts what each stage has to work on, from which the least work follows, and times it on one
/// core: points, voxels, soil_points, plant_points (above the soil), neighbours (of them within
/// seed_radius, all together), stem_points, filled_points, diameter_points, plants, min_neighbors,
/// and seconds (by stage, of every run).
nlohmann::json countWork(const PointCloud& cloud, const StageTiming& timing);

}  // namespace field_phenotyping::benchmark
