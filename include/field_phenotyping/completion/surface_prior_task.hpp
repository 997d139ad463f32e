#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/completion/surface_prior_team.hpp"

namespace field_phenotyping {

/// A stem before anything is fitted, in the local frame of the block's cloud [m]. Move only, for
/// the task points into it.
struct StemToFit {
  std::vector<Eigen::Vector3d> points;  ///< of which a bounded number was kept
  std::vector<Eigen::Vector3d> curve;   ///< the axis as segmented, over the range of the points
  double begin = 0.0;                   ///< arc length on the axis where the curve begins [m]
  SurfacePriorTask task;                ///< of these; without points where there is nothing to fit

  StemToFit() = default;
  StemToFit(StemToFit&&) = default;
  StemToFit& operator=(StemToFit&&) = default;
};

/// Lays the axis out over the range of the points. Thread-safe; deterministic.
StemToFit layOut(const StemToModel& stem);

}  // namespace field_phenotyping
