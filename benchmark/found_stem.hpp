#pragma once

#include <memory>
#include <string>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/completion/completed_block.hpp"

namespace field_phenotyping::benchmark {

/// A stem as the whole pipeline finds it; `plant` lies in `block`.
struct FoundStem {
  std::shared_ptr<const CompletedBlock> block;
  const Plant* plant = nullptr;
};

/// The stem of the plant that has most stem points in a cloud of one plant.
/// @param name of the cloud, for the complaint
/// @throws std::runtime_error when the cloud shows no stem
FoundStem findStem(const PointCloud& cloud, const std::string& name);

}  // namespace field_phenotyping::benchmark
