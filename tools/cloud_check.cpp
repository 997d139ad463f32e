#include "cloud_check.hpp"

#include <algorithm>
#include <array>
#include <sstream>
#include <stdexcept>

#include "field_phenotyping/common/float_step.hpp"
#include "field_phenotyping/common/usual_density.hpp"
#include "field_phenotyping/segmentation/fruitless_blocks.hpp"
#include "point_file.hpp"

namespace field_phenotyping {
namespace {

/// Step [m] that the coarsest of x, y and z of the file comes in; 0: all FLOAT64.
double coordinateResolution(const CloudFile& input) {
  constexpr std::array<const char*, 3> kNames = {"x", "y", "z"};
  double coarsest = 0.0;
  for (std::size_t axis = 0; axis < kNames.size(); ++axis) {
    if (requireField(input.contents, kNames[axis], "input").isDouble()) continue;
    coarsest = std::max(coarsest, floatStep(input.cloud.origin[static_cast<Eigen::Index>(axis)]));
  }
  return coarsest;
}

}  // namespace

void requireMetres(const std::string& path, const CloudFile& input) {
  constexpr std::size_t kFewPoints = 1000U;  // are measured quickly whatever they are
  constexpr std::size_t kLeast = 20U;        // [1/m^2] no plant is found among fewer
  if (input.cloud.size() < kFewPoints) return;
  const std::size_t density = usualDensity(input.cloud);
  if (density >= kLeast) return;
  std::ostringstream text;
  text << path << " has " << density
       << " points a square metre where it has any, and a plant needs "
       << "hundreds: x y z must be in metres. Multiply them by 0.001 if they are millimetres, by "
       << "0.01 if they are centimetres";
  throw std::runtime_error(text.str());
}

std::vector<std::string> doubtsAbout(const CloudFile& input, const PipelineResult& result,
                                     const Parameters& parameters) {
  constexpr double kCoarse = 0.001;  // [m] steps that blur a stem
  std::vector<std::string> doubts;
  const double step = coordinateResolution(input);
  if (step > kCoarse) {
    std::ostringstream text;
    text << "so far from the origin FLOAT32 coordinates come in steps of " << step
         << " m: stems blur. Write x y z as FLOAT64, or subtract an offset before you write them";
    doubts.push_back(text.str());
  }
  if (result.plants.empty()) {
    FruitlessBlocks fruitless;
    for (const auto& block : result.blocks) {
      const SegmentedBlock& segmented = *block->segmented;
      fruitless.add(segmented.header, segmented.cloud.points, segmented.ground,
                    parameters.segmentation);
    }
    doubts.push_back(fruitless.reason(parameters.segmentation));
  } else if (result.blocks_without_soil > 0U) {
    std::ostringstream text;
    text << "no soil seen in " << result.blocks_without_soil << " of " << result.blocks.size()
         << " blocks: heights there are from the lowest plant points";
    if (result.blocks_without_soil == result.blocks.size()) {
      text
          << ". Unless the soil was cut away, make sure that z points up: else these are no plants";
    }
    doubts.push_back(text.str());
  }
  return doubts;
}

}  // namespace field_phenotyping
