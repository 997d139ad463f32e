#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/measurement/cross_section_model.hpp"

namespace field_phenotyping {

/// Where the fit of a piece of stem begins.
struct CrossSectionStart {
  CrossSectionVector parameters;
  double outlier_share = 0.0;
};

/// A rough fit: some steps of estimating equations, once from the reference axis and once from a
/// circle through all points, whichever comes out likelier.
///
/// Given where along the surface a point lies, its distance from the axis follows a Rice
/// distribution with the surface's radius of curvature. The ends of a half-seen arc pull on such a
/// fit, which is why it is only a start.
///
/// @param points as for fitStemCrossSection(), at least five
/// Thread-safe, deterministic.
CrossSectionStart startCrossSection(const std::vector<Eigen::Vector3d>& points,
                                    const CrossSectionPrior& prior, const StemExtent& extent);

}  // namespace field_phenotyping
