#pragma once

#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/bilateral_filter_team.hpp"
#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// I of Eq 25.
enum class FilterAttribute { kNormal, kColor };

struct FilterOptions {
  double sigma_space = 0.003;    ///< [m]; on a thin cylinder at most 0.3 radii
  double sigma_attribute = 0.5;  ///< of the difference of unit normals, or of colours
  FilterAttribute attribute = FilterAttribute::kNormal;
};

/// What a filter is made of.
struct FilterToSolve {
  std::vector<FilterPoint> points;  ///< of the stretch and of at least 2 sigma_space and two rows
                                    ///< beyond it, any order
  FilterGrid grid;
  double radius = 0.0;  ///< of the stem [m]
  FilterOptions options;
};

/// Bilateral filter of a stretch of a completed stem (paper Eq 25): a point moves along the normal
/// only, to the weighted mean of the deviations from the prior surface round it, so that a thin
/// cylinder does not shrink. Weights are G(distance; sigma_space) G(|I_i - I_j|; sigma_attribute).
///
/// It is computed at the middles of the cells of a grid and read off between them, so that its cost
/// does not grow with the number of points. What that widens the filter by is taken off the kernel;
/// one below half a cell is not resolved. Immutable once built, so safe to read from any thread.
class BilateralFilter {
 public:
  BilateralFilter() = default;
  explicit BilateralFilter(const FilterToSolve& given);

  /// Filtered deviation at a place of the stretch in a cell with a point to be read [m]; elsewhere
  /// perhaps 0.
  /// @param color what is there; counts for FilterAttribute::kColor only
  double at(const SurfacePosition& place, const FilterColor& color) const;

 private:
  friend std::vector<BilateralFilter> solveFilters(const std::vector<const FilterToSolve*>& given,
                                                   const ComputeDevice& device);

  FilterGrid grid_;
  double per_attribute_ = 0.0;
  std::vector<FilterNode> nodes_;    // row by row, from one below the stretch to one above it
  std::vector<FilterColor> colors_;  // of the nodes; by colour only
};

/// Many filters at once, a thread block each, on the GPU; with the same bits. What the GPU cannot
/// do the CPU does, on all cores. Thread-safe.
std::vector<BilateralFilter> solveFilters(const std::vector<const FilterToSolve*>& given,
                                          const ComputeDevice& device);

}  // namespace field_phenotyping
