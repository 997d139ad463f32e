#include "found_stem.hpp"

#include <stdexcept>

#include "field_phenotyping/pipeline.hpp"

namespace field_phenotyping::benchmark {

FoundStem findStem(const PointCloud& cloud, const std::string& name) {
  Parameters parameters;
  parameters.completion.enabled = false;
  const PipelineResult result = phenotypeCloud(cloud, parameters);
  FoundStem found;
  for (const auto& block : result.blocks) {
    for (const Plant& plant : block->segmented->plants) {
      if (!plant.owned) continue;
      if (found.plant == nullptr || plant.stem.size() > found.plant->stem.size()) {
        found = {block, &plant};
      }
    }
  }
  if (found.plant == nullptr) {
    throw std::runtime_error(name + " shows no stem; it must hold one plant, z up, in metres");
  }
  return found;
}

}  // namespace field_phenotyping::benchmark
