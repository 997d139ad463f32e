#include "field_phenotyping/measurement/phenotype.hpp"

#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/flag_names.hpp"

namespace field_phenotyping {

std::string flagNames(std::uint32_t flags) {
  static constexpr FlagName kNames[] = {
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
      {kMergedSuspect, "merged_suspect"},
      {kUnlikeStand, "unlike_stand"},
  };
  return joinFlagNames(flags, kNames);
}

double qualityScore(const Phenotype& phenotype) {
  constexpr double kGoodQuality = 0.7, kGoodArc = 0.75;
  constexpr double kUnmeasured = 0.25, kWrong = 0.4, kBad = 0.5, kDoubtful = 0.8;
  const auto known = [](const Trait& trait, double half) {
    const double relative = trait.stddev / trait.value / half;
    return std::isfinite(relative) ? 1.0 / (1.0 + relative * relative) : kUnmeasured;
  };
  double score = std::min(static_cast<double>(phenotype.segmentation_quality) / kGoodQuality, 1.0);
  score *= known(phenotype.stem_diameter, 0.10) * known(phenotype.height, 0.05);
  if (std::isfinite(phenotype.arc_coverage)) {
    score *= std::min(phenotype.arc_coverage / kGoodArc, 1.0);
  }
  for (const QualityFlag flag : {kPoorFit, kPriorDriven, kGroundMissing, kLowConfidence}) {
    if ((phenotype.flags & flag) != 0U) score *= kBad;
  }
  if ((phenotype.flags & kMergedSuspect) != 0U) score *= kWrong;
  for (const QualityFlag flag : {kArcBelow, kHeightShifted, kGroundExtrapolated, kTruncated}) {
    if ((phenotype.flags & flag) != 0U) score *= kDoubtful;
  }
  return score;
}

}  // namespace field_phenotyping
