#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"

namespace field_phenotyping {

/// Middle and standard deviation of values of which a few are wild.
struct RobustSpread {
  float middle;
  float stddev;
};

/// @param values must not be empty
/// @param least  of the standard deviation
inline RobustSpread robustSpreadOf(const std::vector<float>& values, float least) {
  const float middle = medianOf(values);
  std::vector<float> off;
  off.reserve(values.size());
  for (const float value : values) off.push_back(std::abs(value - middle));
  return {middle, std::max(least, static_cast<float>(kMadToSigma) * medianOf(std::move(off)))};
}

}  // namespace field_phenotyping
