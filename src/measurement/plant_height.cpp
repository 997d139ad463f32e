#include "field_phenotyping/measurement/plant_height.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

namespace field_phenotyping {
namespace {

/// An end of the plant, upwards or downwards.
struct End {
  double z = 0.0;        ///< of the outermost point
  double spacing = 0.0;  ///< mean spacing in height of the outermost points
};

/// Points fall on the plant's end at random; beyond the outermost of them it goes on for about the
/// mean spacing of those behind.
template <class Order>
End endOf(std::vector<float> heights, const Order& order) {
  constexpr std::size_t kPoints = 5;
  const std::size_t count = std::min(kPoints, heights.size());
  std::partial_sort(heights.begin(), heights.begin() + static_cast<std::ptrdiff_t>(count),
                    heights.end(), order);
  End end;
  end.z = heights.front();
  if (count > 1U) {
    end.spacing = std::abs(heights.front() - heights[count - 1U]) / static_cast<double>(count - 1U);
  }
  return end;
}

/// Where the stem's line passes height `z`.
Eigen::Vector2f lineAt(const Plant& plant, float z) {
  const Eigen::Vector3f chord = plant.axis.nodes().back().position - plant.base;
  const float rise = std::max(chord.z(), 1e-3F);
  return plant.base.head<2>() + (z - plant.base.z()) / rise * chord.head<2>();
}

/// How far the plant's points reach above the highest of them that stands nearer to its own stem's
/// line than to any other plant's [m]: the tip of a leaf or a branch in a neighbour's place is
/// often the neighbour's. 0 where none stands nearer.
double doubtfulTop(const SegmentedBlock& block, const Plant& plant, float top) {
  constexpr float kReach = 0.35F;     // [m] below the top that is looked at
  constexpr float kNeighbour = 1.0F;  // [m] plants farther away do not matter
  if (plant.axis.empty()) return 0.0;
  std::vector<const Plant*> others;
  for (const Plant& other : block.plants) {
    if (&other == &plant || other.axis.empty()) continue;
    if ((other.base - plant.base).head<2>().norm() < kNeighbour) others.push_back(&other);
  }
  float own_top = -std::numeric_limits<float>::infinity();
  for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
    const Eigen::Vector3f& point = block.cloud.points[i];
    if (point.z() < std::max(top - kReach, own_top)) continue;
    const float own = (point.head<2>() - lineAt(plant, point.z())).norm();
    const bool nearest = std::all_of(others.begin(), others.end(), [&](const Plant* other) {
      return (point.head<2>() - lineAt(*other, point.z())).norm() >= own;
    });
    if (nearest) own_top = point.z();
  }
  return own_top > top - kReach ? static_cast<double>(top - own_top) : 0.0;
}

}  // namespace

PlantHeight measurePlantHeight(const SegmentedBlock& block, const Plant& plant,
                               const MeasurementParameters& parameters) {
  PlantHeight result;
  std::vector<float> heights;
  heights.reserve(plant.points.size());
  for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
    heights.push_back(block.cloud.points[i].z());
  }
  const bool soil = block.ground.observed();
  if (!soil) {
    result.flags |= kGroundMissing;
  } else if (!block.ground.seenAt(plant.base.x(), plant.base.y())) {
    result.flags |= kGroundExtrapolated;
  }
  if (heights.empty()) return result;

  const bool paper = parameters.mode == "paper";
  const End top = endOf(heights, std::greater<float>());
  // Whose the tip is nobody can tell: half of it counts, and as much is not known.
  const double doubt = paper ? 0.0 : 0.5 * doubtfulTop(block, plant, static_cast<float>(top.z));
  const double top_z = top.z - doubt + (paper ? 0.0 : top.spacing);
  if (soil) {
    result.height.value = top_z - block.ground.heightAt(plant.base.x(), plant.base.y());
    // Between the plants soil looks smoother than it is known under one.
    constexpr float kLeastSoilError = 0.008F;  // [m]
    const float soil_error =
        std::max(block.ground.stddevAt(plant.base.x(), plant.base.y()), kLeastSoilError);
    result.height.stddev = std::hypot(std::hypot(top.spacing, doubt), soil_error);
  } else {
    const End bottom = endOf(heights, std::less<float>());
    result.height.value = top_z - bottom.z + (paper ? 0.0 : bottom.spacing);
    result.height.stddev = std::hypot(std::hypot(top.spacing, doubt), bottom.spacing);
  }
  return result;
}

}  // namespace field_phenotyping
