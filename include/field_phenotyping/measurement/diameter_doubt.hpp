#pragma once

#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"

namespace field_phenotyping {

/// What the other stems of a block say of one stem's fit.
struct DiameterDoubt {
  double wrong = 0.0;  ///< probability that the fit is wrong: two stems, or leaves, taken for one
  Trait diameter;      ///< as given, its standard deviation wider by what that makes uncertain [m]
};

/// Empirical Bayes: which of a block's diameters are likelier wrong than odd.
///
/// Where plants stand close, points of neighbours and of sheaths are taken for a stem's, and a
/// surface that fits them well may be none: the fit itself cannot tell. True diameters are taken as
/// normally distributed over the stand, but for some odd plants; wrong fits as scattered far more
/// widely. Mean and spread of the stand and the share of wrong fits are found together (expectation
/// maximisation). Odd plants that are few, and those that were measured to a few per cent, are not
/// doubted; in stands where all diameters are alike or differ as plants do, none is.
///
/// The standard deviation becomes the root mean square error of the value as it is: with the
/// probability that the fit is wrong, the plant is one of the stand.
///
/// @param diameters of a block's stems, with the standard deviations of their fits; NaN where not
///        measured
/// @return one for each; as given where fewer than six were measured
/// Thread-safe, deterministic; the order matters only in rounding.
std::vector<DiameterDoubt> doubtDiameters(const std::vector<Trait>& diameters);

}  // namespace field_phenotyping
