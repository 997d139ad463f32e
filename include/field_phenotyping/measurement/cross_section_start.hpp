#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/measurement/cross_section_start_team.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {

/// What the fit of a piece of stem has to know before it begins.
/// @param points as for fitStemCrossSection(), at least five
/// @param near where to begin, if that is known; else null
/// Thread-safe, deterministic.
CrossSectionTask crossSectionTask(const std::vector<Eigen::Vector3d>& points,
                                  const CrossSectionPrior& prior, const CrossSectionStart* near);

/// The points as the fits take them; they must stay.
CrossSectionPoints placesOf(const std::vector<Eigen::Vector3d>& points);

/// Where the fit of a piece of stem begins: where the task says, or at a rough fit by some steps of
/// estimating equations, once from the reference axis and once from a circle through all points,
/// whichever comes out likelier. Noise nearly as large as the stem leaves no shape to be seen but
/// its size: then a circle is fitted.
///
/// Given where along the surface a point lies, its distance from the axis follows a Rice
/// distribution with the surface's radius of curvature. The ends of a half-seen arc pull on such a
/// fit, which is why it is only a start.
///
/// Thread-safe, deterministic.
CrossSectionStart startCrossSection(const CrossSectionPoints& points, const CrossSectionTask& task);

}  // namespace field_phenotyping
