#pragma once

#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// A place [m], for code that runs on the GPU too.
struct Place {
  float x;
  float y;
  float z;
};

/// The cubic cells of a neighbour search: where a position lies. Rows of cells run along x.
struct GridGeometry {
  float cell = 1.0F;          ///< edge [m]
  float inverse_cell = 1.0F;  ///< [1/m]
  float slack = 0.0F;         ///< [m] that rounding may move a point across a cell's border
  float corner[3] = {0.0F, 0.0F, 0.0F};
  float last[3] = {0.0F, 0.0F, 0.0F};  ///< cell along each axis, whole
  std::uint64_t rows_y = 1U;           ///< rows in a layer
  /// A table says where the points of 2^bucket_shift cells of a row begin, unless it would be too
  /// large.
  bool has_table = false;
  unsigned bucket_shift = 0U;
  std::uint64_t buckets_x = 1U;  ///< in a row
  std::uint64_t buckets = 0U;    ///< in all

  FIELD_PHENOTYPING_HD int cellOf(float position, int axis) const {
    return static_cast<int>((position - corner[axis]) / cell);
  }
  /// The cell of a coordinate, or the nearest one.
  FIELD_PHENOTYPING_HD int nearestCell(float position, int axis) const {
    const float at = (position - corner[axis]) * inverse_cell;
    if (!(at > 0.0F)) return 0;
    return static_cast<int>(at < last[axis] ? at : last[axis]);
  }
  FIELD_PHENOTYPING_HD std::uint64_t rowOf(int y, int z) const {
    return static_cast<std::uint64_t>(z) * rows_y + static_cast<std::uint64_t>(y);
  }
  FIELD_PHENOTYPING_HD std::uint64_t bucketOf(int x, std::uint64_t row) const {
    return row * buckets_x + (static_cast<std::uint64_t>(x) >> bucket_shift);
  }
  /// How far a cell lies outside the coordinates [low, high], at least.
  FIELD_PHENOTYPING_HD float outside(float low, float high, int at, int axis) const {
    const float begin = corner[axis] + static_cast<float>(at) * cell;
    const float below = begin - high - slack;
    const float above = low - begin - cell - slack;
    const float farther = below > above ? below : above;
    return farther > 0.0F ? farther : 0.0F;
  }
};

/// The points of a neighbour search, sorted by cell, wherever they lie in memory: NeighborGrid
/// holds them on the CPU. All pointers are of the machine that the calls are made on.
struct GridView {
  /// Sorted points that lie side by side.
  struct Run {
    std::uint32_t begin;
    std::uint32_t end;
  };

  GridGeometry geometry;
  std::uint32_t size = 0U;
  // Coordinates of the sorted points; kLanes values beyond the last can be read.
  const float* x = nullptr;
  const float* y = nullptr;
  const float* z = nullptr;
  const std::uint32_t* order = nullptr;  ///< source index of each sorted point
  const int* cell_x = nullptr;           ///< of each sorted point; where buckets are not cells
  const std::uint32_t* begin = nullptr;  ///< table of buckets, with its end; where there is one
  const std::uint64_t* row = nullptr;    ///< of each sorted point; where there is no table

  /// Whether the k-th sorted point and another one lie in one cell.
  FIELD_PHENOTYPING_HD bool inOneCell(std::size_t k, std::size_t other) const {
    const GridGeometry& g = geometry;
    return g.cellOf(x[k], 0) == g.cellOf(x[other], 0) &&
           g.cellOf(y[k], 1) == g.cellOf(y[other], 1) && g.cellOf(z[k], 2) == g.cellOf(z[other], 2);
  }

  /// Calls visit(run) for runs of sorted points that hold all within `radius` of [low, high], while
  /// it returns true.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forEachRun(const Place& low, const Place& high, float radius,
                                       Visit&& visit) const {
    if (size == 0U) return;
    const GridGeometry& g = geometry;
    const float reach = radius + g.slack;
    const int low_z = g.nearestCell(low.z - reach, 2);
    const int high_z = g.nearestCell(high.z + reach, 2);
    const int low_y = g.nearestCell(low.y - reach, 1);
    const int high_y = g.nearestCell(high.y + reach, 1);
    // As much of every row: a few points more cost less than to know where the sphere cuts it.
    const int low_x = g.nearestCell(low.x - reach, 0);
    const int high_x = g.nearestCell(high.x + reach, 0);
    for (int at_z = low_z; at_z <= high_z; ++at_z) {
      const float off_z = g.outside(low.z, high.z, at_z, 2);
      const float left = reach * reach - off_z * off_z;
      for (int at_y = low_y; at_y <= high_y; ++at_y) {
        const float off_y = g.outside(low.y, high.y, at_y, 1);
        if (off_y * off_y > left) continue;
        const Run run = findRun(low_x, high_x, g.rowOf(at_y, at_z));
        if (run.begin < run.end && !visit(run)) return;
      }
    }
  }

 private:
  FIELD_PHENOTYPING_HD Run findRun(int low_x, int high_x, std::uint64_t at_row) const {
    if (begin == nullptr) return searchRun(low_x, high_x, at_row);
    Run run{begin[geometry.bucketOf(low_x, at_row)], begin[geometry.bucketOf(high_x, at_row) + 1U]};
    if (geometry.bucket_shift == 0U) return run;
    while (run.begin < run.end && cell_x[run.begin] < low_x) ++run.begin;
    while (run.begin < run.end && cell_x[run.end - 1U] > high_x) --run.end;
    return run;
  }

  FIELD_PHENOTYPING_HD Run searchRun(int low_x, int high_x, std::uint64_t at_row) const {
    return {firstNotBefore(at_row, low_x), firstNotBefore(at_row, high_x + 1)};
  }
  FIELD_PHENOTYPING_HD std::uint32_t firstNotBefore(std::uint64_t at_row, int at_x) const {
    std::uint32_t low = 0U;
    std::uint32_t high = size;
    while (low < high) {
      const std::uint32_t middle = low + (high - low) / 2U;
      const bool before = row[middle] != at_row ? row[middle] < at_row : cell_x[middle] < at_x;
      if (before) {
        low = middle + 1U;
      } else {
        high = middle;
      }
    }
    return low;
  }
};

/// The lanes of the sorted points from `k` on that lie in the run and within `radius` of `center`.
template <class Lanes>
FIELD_PHENOTYPING_HD typename Lanes::Mask nearAmong(const Lanes& lanes, const GridView& grid,
                                                    const Place& center, float radius,
                                                    const GridView::Run& run, std::uint32_t k) {
  const typename Lanes::Float x = lanes.load(grid.x, k, run.end) - lanes.all(center.x);
  const typename Lanes::Float y = lanes.load(grid.y, k, run.end) - lanes.all(center.y);
  const typename Lanes::Float z = lanes.load(grid.z, k, run.end) - lanes.all(center.z);
  return lanes.both(lanes.before(k, run.end),
                    lanes.atMost(x * x + (y * y + z * z), lanes.all(radius * radius)));
}

/// How many points lie within `radius` [m] of `center` (inclusive); counting ends at `enough` or a
/// little later.
template <class Lanes>
FIELD_PHENOTYPING_HD std::uint32_t countWithin(const Lanes& lanes, const GridView& grid,
                                               const Place& center, float radius,
                                               std::uint32_t enough) {
  std::uint32_t found = 0U;
  grid.forEachRun(center, center, radius, [&](const GridView::Run& run) {
    for (std::uint32_t k = run.begin; k < run.end && found < enough; k += kLanes) {
      found += lanes.count(nearAmong(lanes, grid, center, radius, run, k));
    }
    return found < enough;
  });
  return found;
}

}  // namespace field_phenotyping
