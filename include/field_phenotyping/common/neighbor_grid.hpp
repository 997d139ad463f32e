#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// Fixed-radius neighbour search: points sorted by cubic cell, so that a query of radius <= cell
/// visits 27 short runs of consecutive memory.
///
/// Holds a copy of the coordinates in cell order; the source may go away. Read-only after
/// construction, so queries may run in parallel. Points must be finite; extents up to 2^21 cells.
class NeighborGrid {
 public:
  /// @param cell edge of a cell [m], > 0: best near the usual query radius
  NeighborGrid(const std::vector<Eigen::Vector3f>& points, float cell);

  /// Calls visit(index, squared distance) for every point within `radius` of `center` (inclusive),
  /// in an order that depends only on the points.
  template <class Visit>
  void forEachWithin(const Eigen::Vector3f& center, float radius, Visit&& visit) const {
    const float squared_radius = radius * radius;
    const Eigen::Array3i low = clampedCell(center.array() - radius);
    const Eigen::Array3i high = clampedCell(center.array() + radius);
    for (int z = low.z(); z <= high.z(); ++z) {
      for (int y = low.y(); y <= high.y(); ++y) {
        // Cells of one x-run are neighbours in memory.
        const Run run = findRun(low.x(), high.x(), y, z);
        for (std::uint32_t k = run.begin; k < run.end; ++k) {
          const float squared_distance = (points_[k] - center).squaredNorm();
          if (squared_distance <= squared_radius) visit(order_[k], squared_distance);
        }
      }
    }
  }

  /// Indices of the points within `radius` of `center`, appended to the emptied `found`.
  void within(const Eigen::Vector3f& center, float radius,
              std::vector<std::uint32_t>& found) const {
    found.clear();
    forEachWithin(center, radius, [&](std::uint32_t i, float) { found.push_back(i); });
  }

  std::size_t size() const { return points_.size(); }

 private:
  struct Run {
    std::uint32_t begin;
    std::uint32_t end;
  };

  Eigen::Array3i clampedCell(const Eigen::Array3f& position) const;
  Run findRun(int low_x, int high_x, int y, int z) const;

  float cell_;
  Eigen::Array3f corner_ = Eigen::Array3f::Zero();
  Eigen::Array3i cells_ = Eigen::Array3i::Ones();
  std::vector<std::uint64_t> keys_;          // of each point, sorted
  std::vector<std::uint32_t> order_;         // source index of each sorted point
  std::vector<Eigen::Vector3f> points_;      // sorted
  std::vector<std::uint32_t> column_begin_;  // dense index of (y, z) columns when small enough
};

}  // namespace field_phenotyping
