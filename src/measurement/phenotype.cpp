#include "field_phenotyping/measurement/phenotype.hpp"

#include <utility>

namespace field_phenotyping {

std::string flagNames(std::uint32_t flags) {
  static constexpr std::pair<std::uint32_t, const char*> kNames[] = {
      {kTooFewPoints, "too_few_points"},
      {kArcBelow, "arc_below"},
      {kPoorFit, "poor_fit"},
      {kGroundExtrapolated, "ground_extrapolated"},
      {kGroundMissing, "ground_missing"},
      {kHeightShifted, "height_shifted"},
      {kShortStem, "short_stem"},
      {kTruncated, "truncated"},
      {kLowConfidence, "low_confidence"},
      {kPriorDriven, "prior_driven"},
  };
  std::string names;
  for (const auto& [flag, name] : kNames) {
    if ((flags & flag) == 0U) continue;
    if (!names.empty()) names += '|';
    names += name;
  }
  return names.empty() ? "ok" : names;
}

}  // namespace field_phenotyping
