#pragma once

#include "field_phenotyping/measurement/surface_mixture_team.hpp"

namespace field_phenotyping {

/// Maximum-likelihood fit of a piece of stem together with where round it the points lie.
///
/// A measured point is a place of the surface, at an unknown angle, plus isotropic Gaussian noise
/// across the axis, or an outlier anywhere on the disc that holds all points. How many points lie
/// at which angle is not assumed but found: bins round the stem, about one and a half standard
/// deviations of the noise wide, have shares of their own, whose logarithms may not jump much from
/// bin to bin (a random walk). So the ends of a half-seen arc, which the noise blurs, are neither
/// taken for more surface nor for less. That is the nonparametric maximum-likelihood estimator of a
/// mixing distribution (Kiefer and Wolfowitz 1956), here penalised so that shape and shares have
/// one posterior with a normal approximation.
///
/// Newton's method on all parameters, shares and the share of outliers at once, with the observed
/// information of Louis (1982), or with as much of the complete information as makes it positive;
/// each step raises the posterior. It ends where a step of Newton's moves the surface by less than
/// a thousandth of the radius, which leaves a hundredth of that or less. The noise is found by
/// residual maximum likelihood. Where points depart from the surface together, patch by patch and
/// by more than chance, the stem is no exact ellipse; then the fit is done anew, with points that
/// count for as much less than one as they know of each other. Bins are no finer than noise of a
/// fiftieth of the radius needs: thinner noise is found too large, by up to half.
///
/// Thread-safe, deterministic.
SurfaceMixtureFit fitSurfaceMixture(const CrossSectionPoints& points, const CrossSectionTask& task,
                                    const CrossSectionStart& start);

}  // namespace field_phenotyping
