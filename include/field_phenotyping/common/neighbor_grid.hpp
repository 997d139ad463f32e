#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/unset_vector.hpp"

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
    const GridView grid = view();
    const Place place = placeOf(center);
    const VectorLanes lanes;
    grid.forEachRun(place, place, radius, [&](const GridView::Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; k += kLanes) {
        unsigned near = bitsOf(nearAmong(lanes, grid, place, radius, run, k));
        for (; near != 0U; near &= near - 1U) {
          const std::uint32_t at = k + static_cast<std::uint32_t>(__builtin_ctz(near));
          const Eigen::Vector3f offset = Eigen::Vector3f(x_[at], y_[at], z_[at]) - center;
          visit(order_[at], offset,
                offset.x() * offset.x() + (offset.y() * offset.y() + offset.z() * offset.z()));
        }
      }
      return true;
    });
  }

  /// Whether at least `count` points lie within `radius` of `center`. Looks at no more than needed.
  bool hasWithin(const Eigen::Vector3f& center, float radius, std::uint32_t count) const {
    return countWithin(VectorLanes(), view(), placeOf(center), radius, count) >= count;
  }

  /// Calls visit(index) for every point within `radius` of the straight line from `begin` to `end`,
  /// which are two places, in an order that depends only on the points.
  template <class Visit>
  void forEachWithinOfLine(const Eigen::Vector3f& begin, const Eigen::Vector3f& end, float radius,
                           Visit&& visit) const {
    const Eigen::Vector3f line = end - begin;
    const float inverse = 1.0F / line.squaredNorm();
    const Place low = placeOf(begin.cwiseMin(end));
    const Place high = placeOf(begin.cwiseMax(end));
    view().forEachRun(low, high, radius, [&](const GridView::Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; k += kLanes) {
        const Floats x = loadFloats(&x_[k]) - begin.x();
        const Floats y = loadFloats(&y_[k]) - begin.y();
        const Floats z = loadFloats(&z_[k]) - begin.z();
        const Floats along = line.x() * x + (line.y() * y + line.z() * z);
        const Floats share = clampedTo(along * inverse, 0.0F, 1.0F);
        const Floats off_x = x - share * line.x();
        const Floats off_y = y - share * line.y();
        const Floats off_z = z - share * line.z();
        const Floats squared = off_x * off_x + (off_y * off_y + off_z * off_z);
        unsigned near = bitsOf(lanesBefore(run.end - k) & (squared <= radius * radius));
        for (; near != 0U; near &= near - 1U) {
          visit(order_[k + static_cast<std::uint32_t>(__builtin_ctz(near))]);
        }
      }
      return true;
    });
  }

  /// Calls visit(index, point) for every point within `radius` of the box [low, high] and for some
  /// a little farther off, in an order that depends only on the points.
  template <class Visit>
  void forEachNearBox(const Eigen::Vector3f& low, const Eigen::Vector3f& high, float radius,
                      Visit&& visit) const {
    view().forEachRun(placeOf(low), placeOf(high), radius, [&](const GridView::Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; ++k) {
        visit(order_[k], Eigen::Vector3f(x_[k], y_[k], z_[k]));
      }
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

  /// What the search runs on; holds while the grid lives and is not assigned to.
  GridView view() const {
    GridView view;
    view.geometry = geometry_;
    view.size = static_cast<std::uint32_t>(order_.size());
    view.x = x_.data();
    view.y = y_.data();
    view.z = z_.data();
    view.order = order_.data();
    view.cell_x = cell_x_.data();
    view.begin = geometry_.has_table ? begin_.data() : nullptr;
    view.row = rows_.data();
    return view;
  }

  static Place placeOf(const Eigen::Vector3f& point) { return {point.x(), point.y(), point.z()}; }

 private:
  // Put the source indices in order: by row, then by cell; ties by source index, so that the order
  // depends on the points alone.
  void sortByBuckets(const std::vector<Eigen::Vector3f>& points);
  void sortByRows(const std::vector<Eigen::Vector3f>& points);
  void copyPoints(const std::vector<Eigen::Vector3f>& points, std::size_t begin, std::size_t end);
  std::uint64_t rowOf(const Eigen::Vector3f& point) const;

  GridGeometry geometry_;
  UnsetVector<int> cell_x_;           // of each sorted point; empty where buckets are cells
  UnsetVector<std::uint32_t> order_;  // source index of each sorted point
  // The sorted points, padded so that the last lanes can be loaded.
  UnsetVector<float> x_;
  UnsetVector<float> y_;
  UnsetVector<float> z_;
  UnsetVector<std::uint32_t> begin_;  // table of buckets, where it is not too large, or else
  std::vector<std::uint64_t> rows_;   // the row of each sorted point
};

/// The cells of a search over points, with edges of `cell` [m].
/// @throws std::invalid_argument when the cell is not positive, a point is not finite, or they
/// extend over more than 2^21 cells
GridGeometry gridGeometry(const std::vector<Eigen::Vector3f>& points, float cell);

}  // namespace field_phenotyping
