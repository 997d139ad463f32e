#include "field_phenotyping/measurement/pass_fusion.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kDoubtfulHeight = kGroundExtrapolated | kGroundMissing | kTruncated;
constexpr std::uint32_t kDoubtfulDiameter = kTooFewPoints | kArcBelow | kPoorFit | kHeightShifted |
                                            kPriorDriven | kMergedSuspect | kUnlikeStand;

bool counts(const Trait& trait) {
  return std::isfinite(trait.value) && std::isfinite(trait.stddev) && trait.stddev > 0.0;
}

/// The passes that give a trait without doubt or, where none does, all.
std::vector<const Phenotype*> trusted(const std::vector<Phenotype>& passes, Trait Phenotype::*trait,
                                      std::uint32_t doubt) {
  std::vector<const Phenotype*> clear;
  std::vector<const Phenotype*> all;
  for (const Phenotype& pass : passes) {
    if (!counts(pass.*trait)) continue;
    all.push_back(&pass);
    if ((pass.flags & doubt) == 0U) clear.push_back(&pass);
  }
  return clear.empty() ? all : clear;
}

/// The passes that saw a plant's upper part. The edge of the sensor's view may cut it off in one
/// pass; what another has seen is there. Smaller differences may as well be a neighbour's leaf.
std::vector<Phenotype> withTop(const std::vector<Phenotype>& passes) {
  constexpr double kCutOff = 0.2;  // of the height
  double highest = 0.0;
  for (const Phenotype& pass : passes) {
    if (counts(pass.height)) highest = std::max(highest, pass.height.value);
  }
  std::vector<Phenotype> seen;
  std::copy_if(passes.begin(), passes.end(), std::back_inserter(seen), [&](const Phenotype& pass) {
    return counts(pass.height) && pass.height.value >= (1.0 - kCutOff) * highest;
  });
  return seen;
}

Trait fuse(const std::vector<const Phenotype*>& passes, Trait Phenotype::*trait) {
  std::vector<Trait> traits;
  for (const Phenotype* pass : passes) traits.push_back(pass->*trait);
  return fuseTraits(traits);
}

const Phenotype* mostExact(const std::vector<const Phenotype*>& passes, Trait Phenotype::*trait) {
  return *std::min_element(passes.begin(), passes.end(),
                           [&](const Phenotype* a, const Phenotype* b) {
                             return (a->*trait).stddev < (b->*trait).stddev;
                           });
}

}  // namespace

Trait fuseTraits(const std::vector<Trait>& traits) {
  double weights = 0.0;
  double sum = 0.0;
  double count = 0.0;
  for (const Trait& trait : traits) {
    if (!counts(trait)) continue;
    const double weight = 1.0 / (trait.stddev * trait.stddev);
    weights += weight;
    sum += weight * trait.value;
    count += 1.0;
  }
  if (!(weights > 0.0)) return {};
  Trait fused{sum / weights, 1.0 / std::sqrt(weights)};
  if (count < 2.0) return fused;
  double chi_square = 0.0;
  for (const Trait& trait : traits) {
    if (!counts(trait)) continue;
    const double off = (trait.value - fused.value) / trait.stddev;
    chi_square += off * off;
  }
  fused.stddev *= std::sqrt(std::max(1.0, chi_square / (count - 1.0)));
  return fused;
}

Phenotype fusePasses(const std::vector<Phenotype>& passes) {
  Phenotype fused = passes.back();
  fused.passes = static_cast<std::uint32_t>(passes.size());
  if (passes.size() < 2U) return fused;

  const std::vector<Phenotype> with_top = withTop(passes);
  const auto heights = trusted(with_top, &Phenotype::height, kDoubtfulHeight);
  if (!heights.empty()) fused.height = fuse(heights, &Phenotype::height);

  const auto diameters = trusted(passes, &Phenotype::stem_diameter, kDoubtfulDiameter);
  if (!diameters.empty()) {
    fused.stem_diameter = fuse(diameters, &Phenotype::stem_diameter);
    fused.stem_diameter_minor = fuse(diameters, &Phenotype::stem_diameter_minor);
    fused.stem_diameter_equivalent = fuse(diameters, &Phenotype::stem_diameter_equivalent);
    fused.stem_volume = fuse(diameters, &Phenotype::stem_volume);
    const Phenotype* best = mostExact(diameters, &Phenotype::stem_diameter);
    fused.diameter_height = best->diameter_height;
    fused.diameter_prior_share = best->diameter_prior_share;
  }

  const auto leans = trusted(passes, &Phenotype::lean, kOk);
  if (!leans.empty()) {
    fused.lean = fuse(leans, &Phenotype::lean);
    const Phenotype* best = mostExact(leans, &Phenotype::lean);
    fused.axis = best->axis;
    fused.lean_azimuth = best->lean_azimuth;
  }
  for (Trait Phenotype::*trait : {&Phenotype::spacing, &Phenotype::row_spacing}) {
    fused.*trait = fuse(trusted(passes, trait, kOk), trait);
  }

  for (std::size_t k = 0; k + 1U < passes.size(); ++k) {
    const Phenotype& pass = passes[k];
    fused.flags &= pass.flags;
    fused.stem_points += pass.stem_points;
    fused.plant_points += pass.plant_points;
    fused.diameter_points += pass.diameter_points;
    fused.arc_coverage = std::fmax(fused.arc_coverage, pass.arc_coverage);
    fused.completeness = std::fmax(fused.completeness, pass.completeness);
    fused.segmentation_quality = std::max(fused.segmentation_quality, pass.segmentation_quality);
  }
  fused.score = qualityScore(fused);
  return fused;
}

}  // namespace field_phenotyping
