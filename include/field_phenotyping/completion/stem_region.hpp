#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <utility>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"

namespace field_phenotyping {

constexpr double kRegionLength = 0.12;  ///< [m] of stem that is solved at a time
constexpr double kRegionMargin = 0.06;  ///< [m] beyond it from which points count

/// One measured point of a stem on the coarse model's surface.
struct StemPoint {
  Eigen::Vector3f point;     ///< as measured, local frame [m]
  std::uint32_t color = 0U;  ///< 0x00RRGGBB
  std::uint32_t rank = 0U;   ///< among the stem's points
  UnrolledPoint unrolled;
  double deviation = 0.0;  ///< from the prior surface, noise bias taken off [m]
  double weight = 0.0;     ///< 0: not on the stem's surface
};

/// What all regions of a stem share: the coarse model and how finely it is solved. Read-only.
struct StemModel {
  const SurfacePrior& prior;
  const GroundModel& ground;
  std::vector<StemPoint> points = {};  ///< in order of s
  bool has_colors = false;
  FillRange range = {};       ///< what may be filled
  double density = 0.0;       ///< [1/m^2]
  double prior_weight = 0.0;  ///< alpha of Eq 20
  double smoothing = 0.0;     ///< sigma_s of Eq 25 [m]
  double max_stddev = 0.0;    ///< [m]
  CenterLattice lattice = {};
  RbfSurface::Options surface = {};
};

/// A solved piece of a stem.
struct StemRegion {
  std::vector<Eigen::Vector3f> points;    ///< filled in, local frame [m]
  std::vector<std::uint32_t> colors;      ///< of each; empty when the cloud has none
  std::vector<float> stddev;              ///< of each one's distance to the true surface [m]
  std::vector<Eigen::Vector3f> smoothed;  ///< the region's measured points after Eq 25, see below
  std::uint32_t uncertain = 0U;  ///< places left open because the surface is not known well enough
  bool no_surface = false;       ///< its points do not lie on one surface, as at a fork
};

/// The points of the model with arc lengths in [begin, end).
std::pair<std::vector<StemPoint>::const_iterator, std::vector<StemPoint>::const_iterator>
pointsBetween(const StemModel& model, double begin, double end);

/// Indices into model.points of a region's measured points, ordered by their coordinates: the order
/// of StemRegion::smoothed, whatever else of the stem changes.
std::vector<std::uint32_t> regionPoints(const StemModel& model, long index);

/// Regions are numbered by the arc length of the axis that the prior was fitted to.
long regionAt(const SurfacePrior& prior, double s);
double regionBegin(const SurfacePrior& prior, long index);  ///< arc length of the frame [m]

/// Steps 2 to 6 of paper 2.5 for one region: deviations from the prior (Eq 20) interpolated (Eq 19,
/// 21), where and how many points are missing (Eq 22), their colours (Eq 23), the bilateral filter
/// (Eq 25), and repair of defects (Eq 26). Reads the points of the region and of its margin only.
/// @param own of regionPoints()
StemRegion solveRegion(const StemModel& model, long index, const std::vector<std::uint32_t>& own);

}  // namespace field_phenotyping
