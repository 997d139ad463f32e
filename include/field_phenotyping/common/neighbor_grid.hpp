#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
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
    forEachOffsetWithin(center, radius,
                        [&](std::uint32_t i, const Eigen::Vector3f& /*offset*/, float squared) {
                          visit(i, squared);
                        });
  }

  /// The same with visit(index, point - center, squared distance), in the same order.
  template <class Visit>
  void forEachOffsetWithin(const Eigen::Vector3f& center, float radius, Visit&& visit) const {
    if (points_.empty()) return;
    const float squared_radius = radius * radius;
    const float reach = radius + slack_;
    const int low_z = cellAt(center.z() - reach, 2);
    const int high_z = cellAt(center.z() + reach, 2);
    const int low_y = cellAt(center.y() - reach, 1);
    const int high_y = cellAt(center.y() + reach, 1);
    for (int z = low_z; z <= high_z; ++z) {
      const float off_z = outside(center.z(), z, 2);
      const float left_z = reach * reach - off_z * off_z;
      for (int y = low_y; y <= high_y; ++y) {
        // Only the part of the row that the sphere reaches.
        const float off_y = outside(center.y(), y, 1);
        const float left = left_z - off_y * off_y;
        if (left < 0.0F) continue;
        const float half = std::sqrt(left) + slack_;
        // Cells of one x-run are neighbours in memory.
        const Run run = findRun(cellAt(center.x() - half, 0), cellAt(center.x() + half, 0), y, z);
        for (std::uint32_t k = run.begin; k < run.end; ++k) {
          const Eigen::Vector3f offset = points_[k] - center;
          const float squared_distance = offset.squaredNorm();
          if (squared_distance <= squared_radius) visit(order_[k], offset, squared_distance);
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

  /// The cell of a coordinate, or the nearest one.
  int cellAt(float position, int axis) const {
    const float at = (position - corner_[axis]) * inverse_cell_;
    return at > 0.0F ? static_cast<int>(std::min(at, last_[axis])) : 0;
  }
  /// How far a coordinate lies outside a cell, at least.
  float outside(float position, int cell, int axis) const {
    const float low = corner_[axis] + static_cast<float>(cell) * cell_;
    return std::max({0.0F, low - position - slack_, position - low - cell_ - slack_});
  }
  Run findRun(int low_x, int high_x, int y, int z) const {
    if (column_begin_.empty()) return searchRun(low_x, high_x, y, z);
    const std::size_t column =
        static_cast<std::size_t>(z) * columns_y_ + static_cast<std::size_t>(y);
    Run run{column_begin_[column], column_begin_[column + 1U]};
    constexpr std::uint32_t kLong = 32U;  // more are worth a search
    if (run.end - run.begin > kLong) return narrowRun(run, low_x, high_x);
    while (run.begin < run.end && cell_x_[run.begin] < low_x) ++run.begin;
    while (run.begin < run.end && cell_x_[run.end - 1U] > high_x) --run.end;
    return run;
  }
  Run narrowRun(const Run& column, int low_x, int high_x) const;
  Run searchRun(int low_x, int high_x, int y, int z) const;

  float cell_;
  float inverse_cell_;
  float slack_ = 0.0F;  // [m] that rounding may move a point across a cell's border
  Eigen::Array3f corner_ = Eigen::Array3f::Zero();
  Eigen::Array3f last_ = Eigen::Array3f::Zero();  // cell along each axis
  std::size_t columns_y_ = 1U;
  std::vector<int> cell_x_;                  // of each sorted point
  std::vector<std::uint32_t> order_;         // source index of each sorted point
  std::vector<Eigen::Vector3f> points_;      // sorted
  std::vector<std::uint32_t> column_begin_;  // dense index of (y, z) columns when small enough,
  std::vector<std::uint64_t> columns_;       // or the column of each sorted point
};

}  // namespace field_phenotyping
