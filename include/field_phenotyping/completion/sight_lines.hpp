#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"

namespace field_phenotyping {

/// The way of one beam: from where the sensor was to the point that it saw. Local frame [m].
struct SightLine {
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();
  Eigen::Vector3f end = Eigen::Vector3f::Zero();
};

/// The beams of a cloud that pass the stem nearby and end beyond it, as far as their scan's origin
/// is known.
/// @param stem its own points, which end no beam beyond it
std::vector<SightLine> sightLinesPast(const PointCloud& cloud, IndexSpan stem,
                                      const SurfacePrior& prior);

/// Stretches of the stem [arc length, m] where the sensor saw empty space: at least two beams went
/// right through it, within half a radius of its axis, and on for 3 cm or more. Ascending,
/// disjoint.
std::vector<std::pair<double, double>> emptyStretches(const SurfacePrior& prior,
                                                      const std::vector<SightLine>& sight);

}  // namespace field_phenotyping
