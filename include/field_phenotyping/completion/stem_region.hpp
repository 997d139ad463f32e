#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "field_phenotyping/completion/bilateral_filter.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/measured_surface.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"

namespace field_phenotyping {

constexpr long kSlicesPerRegion = 2;  ///< a region is solved at a time; points count from the slice
                                      ///< below it to the one above
constexpr double kRegionLength = kSlicesPerRegion * kSliceLength;  ///< [m]

constexpr double kLeastPriorWeight = 0.1;  ///< deviations are scaled back from alpha by no less

/// How the points of a stem scatter about its model. Estimates, so that a stem that is completed
/// again keeps them until they are clearly others.
struct ScatterModel {
  double noise = 0.0;        ///< the sensor's variance [m^2]
  double noise_error = 0.0;  ///< standard error of that [m^2]
  double misfit = 0.0;       ///< variance that is the stem's own, finer than the model [m^2]

  /// What points scatter beyond the sensor's noise, less half a standard error of either [m^2]:
  /// where there are few points it says nothing.
  /// @param squares sum of their squared distances from the surface [m^2]
  double beyondNoise(double points, double squares) const;
};

/// What all regions of a stem share: the coarse model and how finely it is solved. Read-only.
struct StemModel {
  const SurfacePrior& prior;
  const MeasuredSurface& measured;
  const GroundModel& ground;
  FillRange range = {};  ///< what may be filled
  double density = 0.0;  ///< [1/m^2]
  ScatterModel scatter = {};
  double prior_weight = 0.0;  ///< alpha of Eq 20
  double smoothing = 0.0;     ///< sigma_s of Eq 25 [m]
  double max_stddev = 0.0;    ///< [m]
  CenterLattice lattice = {};
  RbfOptions surface = {};
};

/// @param rgb 0 ... 255
FilterColor filterColorOf(const Eigen::Vector3f& rgb);

/// A solved piece of a stem.
struct StemRegion {
  std::vector<Eigen::Vector3f> points;  ///< filled in, local frame [m]
  std::vector<std::uint32_t> colors;    ///< of each; empty when the cloud has none
  std::vector<float> stddev;            ///< of each one's distance to the true surface [m]
  BilateralFilter filter;        ///< by its measured and filled points (Eq 25), s from the begin
  bool is_smoothed = false;      ///< whether the filter says anything
  std::uint32_t uncertain = 0U;  ///< places left open because the surface is not known well enough
  bool no_surface = false;       ///< its points do not lie on one surface, as at a fork
};

/// Regions are numbered by the arc length of the axis that the prior was fitted to.
long regionAt(const SurfacePrior& prior, double s);
double regionBegin(const SurfacePrior& prior, long index);  ///< arc length of the frame [m]

/// Steps 2 to 6 of paper 2.5 for one region: deviations from the prior (Eq 20) interpolated (Eq 19,
/// 21), where and how many points are missing (Eq 22), their colours (Eq 23), the bilateral filter
/// (Eq 25), and repair of defects (Eq 26). Reads the slices of the region and one beside each end.
StemRegion solveRegion(const StemModel& model, long index);

/// The same in steps, between which the surfaces, gaps and filters of many regions are found at
/// once.
class RegionSolver {
 public:
  /// @param model must stay as long as this
  RegionSolver(const StemModel& model, long index);
  ~RegionSolver();
  RegionSolver(RegionSolver&&) noexcept;
  RegionSolver& operator=(RegionSolver&&) noexcept;

  /// The surface of Eq 19 to 21 and where it is to be read; null where it is nowhere.
  const RbfToRead* surface() const;
  /// Where its gaps are looked for (Eq 22); null where nothing is filled.
  const GapsToFill* gaps() const;
  /// @param deviations of the surface's places, see readSurfaces(); none where there is no surface
  /// @param samples points in the gaps, see sampleGaps(); none where nothing is filled
  void fill(const std::vector<double>& deviations, const GapSamples& samples);
  /// The filter of Eq 25, once gaps are filled; null where nothing is to be smoothed.
  const FilterToSolve* filter() const;
  /// @param filter that, see solveFilters(); or none
  StemRegion finish(BilateralFilter filter);

 private:
  class Work;
  std::unique_ptr<Work> work_;
};

}  // namespace field_phenotyping
