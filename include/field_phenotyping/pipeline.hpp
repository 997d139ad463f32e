#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"

namespace field_phenotyping {

/// Which organ a point was given to.
enum class Part : std::uint8_t { kNone = 0U, kStem = 1U, kOther = 2U };

/// Plant and organ of one input point.
struct PointLabel {
  std::int32_t plant_id = -1;
  Part part = Part::kNone;
};

/// Wall time of one stage, summed over the blocks, and what it was computed on.
struct StageTime {
  std::string stage;
  double seconds = 0.0;
  std::size_t points = 0U;
  DeviceUse use = {};
};

/// Everything that is known about one cloud after the pipeline has run over it.
struct PipelineResult {
  std::vector<Phenotype> plants;   ///< ordered by id
  std::vector<PointLabel> labels;  ///< one per input point, in the input's order
  std::vector<std::shared_ptr<const CompletedBlock>> blocks;  ///< in order of their index
  std::vector<StageTime> times;
  std::size_t blocks_without_soil = 0U;
};

/// Called with the share of work done, in [0, 1]; from any thread, one call at a time.
using ProgressCallback = std::function<void(double)>;

/// Runs the four stages over one accumulated cloud: the same steps that the nodelets take.
/// Blocks are worked in parallel. Deterministic whatever the thread count and the device.
/// @throws std::invalid_argument when a parameter is out of range
PipelineResult phenotypeCloud(const PointCloud& cloud, const Parameters& parameters,
                              const ProgressCallback& progress = {},
                              const ComputeDevice& device = {});

}  // namespace field_phenotyping
