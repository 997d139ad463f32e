#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/vector3.hpp"
#include "field_phenotyping/completion/surface_index_view.hpp"

namespace field_phenotyping {

/// A position on the unrolled stem.
struct SurfacePosition {
  double theta = 0.0;  ///< [rad]
  double s = 0.0;      ///< [m]
};

/// Nearest-neighbour search on the unrolled stem, periodic in theta.
///
/// The surface is rolled onto a straight cylinder of one radius and distances are taken through it:
/// smooth across theta = +-pi, and a Gaussian of them is positive definite, which one of the
/// wrapped distance is not. Read-only after construction, so queries may run in parallel.
class SurfaceIndex {
 public:
  SurfaceIndex() = default;
  /// @param radius of the straight cylinder [m], > 0
  SurfaceIndex(const std::vector<SurfacePosition>& points, double radius);

  /// The K nearest points, ties in the order of s; indices are those of the given points.
  template <std::size_t K>
  NearestOnSurface<K> nearest(const SurfacePosition& query) const {
    return nearest<K>(embed(query));
  }
  template <std::size_t K>
  NearestOnSurface<K> nearest(const Vector3& query) const {
    return nearestWithin<K>(query, SurfaceIndexView::kInfinity);
  }

  /// The K nearest points nearer than `reach` [m].
  template <std::size_t K>
  NearestOnSurface<K> nearestWithin(const SurfacePosition& query, double reach) const {
    return nearestWithin<K>(embed(query), reach);
  }
  /// @param query on the straight cylinder
  template <std::size_t K>
  NearestOnSurface<K> nearestWithin(const Vector3& query, double reach) const {
    NearestOnSurface<K> found = view().nearestWithin<K>(query, reach);
    for (std::size_t k = 0; k < found.count; ++k) found.index[k] = order_[found.index[k]];
    return found;
  }

  /// Calls visit(index, squared distance) for every point within `reach` [m], in order of s.
  template <class Visit>
  void forEachWithin(const SurfacePosition& query, double reach, Visit&& visit) const {
    view().forEachWithin(embed(query), reach, [&](std::size_t i, double squared_distance) {
      visit(order_[i], squared_distance);
    });
  }

  /// Position on the straight cylinder.
  Vector3 embed(const SurfacePosition& p) const {
    return {radius_ * std::cos(p.theta), radius_ * std::sin(p.theta), p.s};
  }

  std::size_t size() const { return points_.size(); }
  double radius() const { return radius_; }

  /// The points on the straight cylinder, in order of s, and which of the given ones each is.
  SurfaceIndexView view() const { return {points_.data(), points_.size()}; }
  const std::vector<std::uint32_t>& order() const { return order_; }

 private:
  double radius_ = 1.0;
  std::vector<std::uint32_t> order_;
  std::vector<Vector3> points_;
};

}  // namespace field_phenotyping
