#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"

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
    forEachRun(center, center, radius, [&](const Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; k += kLanes) {
        const Floats lanes = squaredDistances(center, k);
        std::array<float, kLanes> squared;
        store(lanes, squared.data());
        for (unsigned near = nearAmong(lanes, radius, run, k); near != 0U; near &= near - 1U) {
          const auto lane = static_cast<std::uint32_t>(__builtin_ctz(near));
          const Eigen::Vector3f offset =
              Eigen::Vector3f(x_[k + lane], y_[k + lane], z_[k + lane]) - center;
          visit(order_[k + lane], offset, squared[lane]);
        }
      }
      return true;
    });
  }

  /// Whether at least `count` points lie within `radius` of `center`. Looks at no more than needed.
  bool hasWithin(const Eigen::Vector3f& center, float radius, std::uint32_t count) const {
    constexpr std::array<std::uint8_t, 1U << kLanes> kBits{0U, 1U, 1U, 2U, 1U, 2U, 2U, 3U,
                                                           1U, 2U, 2U, 3U, 2U, 3U, 3U, 4U};
    std::uint32_t found = 0U;
    forEachRun(center, center, radius, [&](const Run& run) {
      for (std::uint32_t k = run.begin; k < run.end && found < count; k += kLanes) {
        found += kBits[nearAmong(squaredDistances(center, k), radius, run, k)];
      }
      return found < count;
    });
    return found >= count;
  }

  /// Calls visit(index, point) for every point within `radius` of the box [low, high] and for some
  /// a little farther off, in an order that depends only on the points.
  template <class Visit>
  void forEachNearBox(const Eigen::Vector3f& low, const Eigen::Vector3f& high, float radius,
                      Visit&& visit) const {
    forEachRun(low, high, radius, [&](const Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; ++k) {
        visit(order_[k], Eigen::Vector3f(x_[k], y_[k], z_[k]));
      }
      return true;
    });
  }

  /// Some of the points, coordinate by coordinate, in an order that depends only on the points.
  /// kLanes values can be loaded from any of them.
  struct Coordinates {
    const float* x;
    const float* y;
    const float* z;
    std::size_t count;
  };
  /// Calls visit(coordinates) for runs of the points that forEachNearBox() visits.
  template <class Visit>
  void forEachRunNearBox(const Eigen::Vector3f& low, const Eigen::Vector3f& high, float radius,
                         Visit&& visit) const {
    forEachRun(low, high, radius, [&](const Run& run) {
      visit(Coordinates{&x_[run.begin], &y_[run.begin], &z_[run.begin], run.end - run.begin});
      return true;
    });
  }

  /// Indices of the points within `radius` of `center`, appended to the emptied `found`.
  void within(const Eigen::Vector3f& center, float radius,
              std::vector<std::uint32_t>& found) const {
    found.clear();
    forEachWithin(center, radius, [&](std::uint32_t i, float) { found.push_back(i); });
  }

  std::size_t size() const { return order_.size(); }

  /// Source index of the k-th point by cells: neighbours in this order are near in space.
  std::uint32_t sorted(std::size_t k) const { return order_[k]; }
  /// Whether the k-th point by cells and another one lie in one cell.
  bool inOneCell(std::size_t k, std::size_t other) const {
    return cellsOf({x_[k], y_[k], z_[k]}) == cellsOf({x_[other], y_[other], z_[other]});
  }

 private:
  struct Run {
    std::uint32_t begin;
    std::uint32_t end;
  };

  /// Squared distances of kLanes sorted points from a place.
  Floats squaredDistances(const Eigen::Vector3f& center, std::size_t first) const {
    const Floats x = loadFloats(&x_[first]) - center.x();
    const Floats y = loadFloats(&y_[first]) - center.y();
    const Floats z = loadFloats(&z_[first]) - center.z();
    return x * x + (y * y + z * z);
  }
  /// A bit for each of those that lie within `radius` and in the run.
  static unsigned nearAmong(const Floats& squared, float radius, const Run& run,
                            std::uint32_t first) {
    const unsigned near = bitsOf(squared <= radius * radius);
    const std::uint32_t left = run.end - first;
    return left < kLanes ? near & ((1U << left) - 1U) : near;
  }

  /// Calls visit(run) for runs of sorted points that hold all within `radius` of [low, high], while
  /// it returns true.
  template <class Visit>
  void forEachRun(const Eigen::Vector3f& low, const Eigen::Vector3f& high, float radius,
                  Visit&& visit) const {
    if (order_.empty()) return;
    const float reach = radius + slack_;
    const int low_z = cellAt(low.z() - reach, 2);
    const int high_z = cellAt(high.z() + reach, 2);
    const int low_y = cellAt(low.y() - reach, 1);
    const int high_y = cellAt(high.y() + reach, 1);
    // As much of every row: a few points more cost less than to know where the sphere cuts it.
    const int low_x = cellAt(low.x() - reach, 0);
    const int high_x = cellAt(high.x() + reach, 0);
    for (int z = low_z; z <= high_z; ++z) {
      const float off_z = outside(low.z(), high.z(), z, 2);
      const float left = reach * reach - off_z * off_z;
      for (int y = low_y; y <= high_y; ++y) {
        const float off_y = outside(low.y(), high.y(), y, 1);
        if (off_y * off_y > left) continue;
        const Run run = findRun(low_x, high_x, y, z);
        if (run.begin < run.end && !visit(run)) return;
      }
    }
  }

  std::array<int, 3> cellsOf(const Eigen::Vector3f& point) const {
    const Eigen::Array3f at = (point.array() - corner_) / cell_;
    return {static_cast<int>(at.x()), static_cast<int>(at.y()), static_cast<int>(at.z())};
  }
  /// The cell of a coordinate, or the nearest one.
  int cellAt(float position, int axis) const {
    const float at = (position - corner_[axis]) * inverse_cell_;
    return at > 0.0F ? static_cast<int>(std::min(at, last_[axis])) : 0;
  }
  /// How far a cell lies outside the coordinates [low, high], at least.
  float outside(float low, float high, int cell, int axis) const {
    const float begin = corner_[axis] + static_cast<float>(cell) * cell_;
    return std::max({0.0F, begin - high - slack_, low - begin - cell_ - slack_});
  }
  Run findRun(int low_x, int high_x, int y, int z) const {
    const std::size_t row = static_cast<std::size_t>(z) * rows_y_ + static_cast<std::size_t>(y);
    if (begin_.empty()) return searchRun(low_x, high_x, row);
    const std::size_t first = row * buckets_x_ + (static_cast<std::size_t>(low_x) >> bucket_shift_);
    const std::size_t last = row * buckets_x_ + (static_cast<std::size_t>(high_x) >> bucket_shift_);
    Run run{begin_[first], begin_[last + 1U]};
    if (bucket_shift_ == 0U) return run;
    while (run.begin < run.end && cell_x_[run.begin] < low_x) ++run.begin;
    while (run.begin < run.end && cell_x_[run.end - 1U] > high_x) --run.end;
    return run;
  }
  Run searchRun(int low_x, int high_x, std::size_t row) const;

  float cell_;
  float inverse_cell_;
  float slack_ = 0.0F;  // [m] that rounding may move a point across a cell's border
  Eigen::Array3f corner_ = Eigen::Array3f::Zero();
  Eigen::Array3f last_ = Eigen::Array3f::Zero();  // cell along each axis
  std::size_t rows_y_ = 1U;
  std::vector<int> cell_x_;           // of each sorted point
  std::vector<std::uint32_t> order_;  // source index of each sorted point
  // The sorted points, padded so that the last lanes can be loaded.
  std::vector<float> x_;
  std::vector<float> y_;
  std::vector<float> z_;
  // Where the points of 2^bucket_shift_ cells of a row begin, if they are not too many buckets, or
  // else the row of each sorted point.
  std::vector<std::uint32_t> begin_;
  unsigned bucket_shift_ = 0U;
  std::size_t buckets_x_ = 1U;
  std::vector<std::uint64_t> rows_;
};

}  // namespace field_phenotyping
