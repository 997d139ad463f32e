#pragma once

#include <vector>

#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"

namespace field_phenotyping {

/// A point of the completed stem: its place and its deviation from the prior surface.
struct CompletedPoint {
  SurfacePosition position;
  double deviation = 0.0;  ///< [m]
  double variance = 0.0;   ///< of the surface there [m^2], where it is known
};

/// Topological defects of a completed stem (regions Omega_k of paper Eq 26) are holes in it: places
/// where neither a measured nor a filled point is as near as the density asks for. Folds become
/// holes: filled points that have left the stem, by more than `most_deviation` [m] from the prior
/// surface, are taken out of `filled` first.
/// @param given where the gaps were that have been filled
std::vector<GapRegion> findDefects(const GapsToFill& given, std::vector<CompletedPoint>& filled,
                                   double most_deviation);

/// New points for one defect, one a cell, on the weighted RBF surface (Eq 26) through its boundary:
/// the points within three spacings of it. Empty where it has no boundary.
/// @param points all of the completed stem round the defect, in any order
std::vector<CompletedPoint> repairDefect(const GapRegion& defect,
                                         const std::vector<CompletedPoint>& points, double density,
                                         double mean_radius, const RbfOptions& options);

}  // namespace field_phenotyping
