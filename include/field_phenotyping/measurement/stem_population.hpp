#pragma once

#include <vector>

#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {

/// What a block's stems say about each other.
enum class PopulationPrior {
  kShape,         ///< noise, taper and ellipticity; the diameter loosely
  kShapeAndSize,  ///< and the diameter itself
};

/// Empirical Bayes: the prior for one more stem of a block, from fits of its stems with `weak`
/// priors.
///
/// Noise, taper, its change with height, ellipticity and the radius are taken as normally
/// distributed over the stems, each fit counting by its own standard deviation. Every spread up to
/// that of the weak prior is weighed by how likely it makes the fits: with few stems, or stems of
/// which little is known, the prior stays nearly as weak as it was. With kShape the radius' spread
/// is a fifth of its mean or more, which carries stems of which hardly anything is seen, and tells
/// leaf points from a stem's, but moves no stem that is known well.
///
/// @return `weak` where fewer than six stems were fitted well, and for what `weak` gives as known
/// Thread-safe; the order of the fits does not matter beyond rounding.
CrossSectionPrior populationPrior(const std::vector<StemCrossSection>& fits,
                                  const CrossSectionPrior& weak, PopulationPrior kind);

}  // namespace field_phenotyping
