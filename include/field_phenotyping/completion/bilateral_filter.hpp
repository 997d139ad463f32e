#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// A point of the completed stem, as the filter sees it.
struct FilterPoint {
  SurfacePosition position;  ///< theta in [-2 pi, 2 pi]
  double deviation = 0.0;    ///< from the stem's prior surface, along its normal [m]
  double weight = 1.0;       ///< how many points it stands for
  Eigen::Vector3f color = Eigen::Vector3f::Zero();  ///< rgb in [0, 1]
};

/// I of Eq 25.
enum class FilterAttribute { kNormal, kColor };

struct FilterOptions {
  double sigma_space = 0.003;    ///< [m]; on a thin cylinder at most 0.3 radii
  double sigma_attribute = 0.5;  ///< of the difference of unit normals, or of colours
  FilterAttribute attribute = FilterAttribute::kNormal;
};

/// Bilateral filter of a completed stem (paper Eq 25): a point moves along the normal only, to the
/// weighted mean of its neighbours' deviations from the prior surface, so that a thin cylinder does
/// not shrink. Weights are G(distance; sigma_space) G(|I_i - I_j|; sigma_attribute).
/// @param points in order of s
/// @param wanted indices of those that are filtered
/// @param radius of the stem [m]
/// @return new deviation of each wanted point [m]. About 40 neighbours of a point are looked at,
/// whatever their density.
std::vector<double> filterDeviations(const std::vector<FilterPoint>& points,
                                     const std::vector<std::uint32_t>& wanted, double radius,
                                     const FilterOptions& options);

}  // namespace field_phenotyping
