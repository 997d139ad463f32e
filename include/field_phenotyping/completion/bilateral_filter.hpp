#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// A point of the completed stem, as the filter sees it.
struct FilterPoint {
  SurfacePosition position;
  double deviation = 0.0;  ///< from the stem's prior surface, along its normal [m]
  Eigen::Vector3f attribute =
      Eigen::Vector3f::Zero();  ///< I of Eq 25: unit normal, or rgb in [0, 1]
};

/// Bilateral filter of a completed stem (paper Eq 25): a point moves along the normal only, to the
/// weighted mean of its neighbours' deviations from the prior surface, so that a thin cylinder does
/// not shrink. Weights are G(distance; sigma_space) G(|I_i - I_j|; sigma_attribute).
/// @param points       in order of s
/// @param wanted       indices into `points`
/// @param radius       of the stem [m]
/// @param sigma_space  [m]; the paper's form asks for at most 0.3 radii
/// @return new deviation of each wanted point. About 64 neighbours of a point are looked at,
/// whatever their density.
std::vector<double> filterDeviations(const std::vector<FilterPoint>& points,
                                     const std::vector<std::uint32_t>& wanted, double radius,
                                     double sigma_space, double sigma_attribute);

}  // namespace field_phenotyping
