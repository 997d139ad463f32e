#include "field_phenotyping/measurement/plant_height.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
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
  const double top_z = top.z + (paper ? 0.0 : top.spacing);
  if (soil) {
    result.height.value = top_z - block.ground.heightAt(plant.base.x(), plant.base.y());
    // Between the plants soil looks smoother than it is known under one.
    constexpr float kLeastSoilError = 0.008F;  // [m]
    const float soil_error =
        std::max(block.ground.stddevAt(plant.base.x(), plant.base.y()), kLeastSoilError);
    result.height.stddev = std::hypot(top.spacing, soil_error);
  } else {
    const End bottom = endOf(heights, std::less<float>());
    result.height.value = top_z - bottom.z + (paper ? 0.0 : bottom.spacing);
    result.height.stddev = std::hypot(top.spacing, bottom.spacing);
  }
  return result;
}

}  // namespace field_phenotyping
