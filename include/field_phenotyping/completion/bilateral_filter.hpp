#pragma once

#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// One or more points of the completed stem in about one place, as the filter sees them.
struct FilterPoint {
  SurfacePosition position;
  double deviation = 0.0;  ///< from the stem's prior surface, along its normal [m]
  double weight = 1.0;     ///< how many points they are
  Eigen::Vector3f color = Eigen::Vector3f::Zero();  ///< rgb in [0, 1]
  bool is_read = true;  ///< whether the filter will be read in its cell of the grid
};

/// I of Eq 25.
enum class FilterAttribute { kNormal, kColor };

struct FilterOptions {
  double sigma_space = 0.003;    ///< [m]; on a thin cylinder at most 0.3 radii
  double sigma_attribute = 0.5;  ///< of the difference of unit normals, or of colours
  FilterAttribute attribute = FilterAttribute::kNormal;
};

/// Cells of a stretch of the unrolled stem: rows begin at s = 0, columns at theta = -pi.
struct FilterGrid {
  double row_height = 0.0;  ///< [m]
  int rows = 0;
  int columns = 0;
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
  /// @param points of the stretch and of at least 2 sigma_space and two rows beyond it, any order
  /// @param radius of the stem [m]
  BilateralFilter(const std::vector<FilterPoint>& points, const FilterGrid& grid, double radius,
                  const FilterOptions& options);

  /// Filtered deviation at a place of the stretch in a cell with a point to be read [m]; elsewhere
  /// perhaps 0.
  /// @param color what is there, rgb in [0, 1]; counts for FilterAttribute::kColor only
  double at(const SurfacePosition& place, const Eigen::Vector3f& color) const;

 private:
  struct Node {
    float deviation = 0.0F;
    float weight = 0.0F;  // 0: unknown
  };

  FilterGrid grid_;
  double per_attribute_ = 0.0;
  std::vector<Node> nodes_;              // row by row, from one below the stretch to one above it
  std::vector<Eigen::Vector3f> colors_;  // of the nodes; by colour only
};

}  // namespace field_phenotyping
