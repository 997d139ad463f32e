#pragma once

#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"

namespace field_phenotyping {

/// One value from independent ones of the same plant, weighted by 1 / stddev^2. Where they differ
/// by more than their standard deviations allow, the result's is widened as much (Birge 1932).
/// Values that are not finite, or whose stddev is not, do not count; NaN where none does.
Trait fuseTraits(const std::vector<Trait>& traits);

/// What is known of a plant that was passed several times, from what was measured in each pass.
/// Where a pass gives a trait with doubt (its flags say so) and another without, the doubtful one
/// does not count; a flag stays where no pass is free of it. A pass whose height lies a fifth
/// below another's has not seen the upper part: it does not count there. Points are summed,
/// coverage is the best pass's, place and growth are the newest's.
/// @param passes at least one, oldest first
/// Thread-safe.
Phenotype fusePasses(const std::vector<Phenotype>& passes);

}  // namespace field_phenotyping
