#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

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
/// wrapped distance is not. Points are kept in order of s; a query walks away from its own s until
/// nothing nearer can follow. Read-only after construction, so queries may run in parallel.
class SurfaceIndex {
 public:
  template <std::size_t K>
  struct Nearest {
    std::array<std::uint32_t, K> index{};    ///< in the given points, nearest first
    std::array<double, K> squared_distance;  ///< [m^2]; infinite where there are fewer points
    std::size_t count = 0;
  };

  SurfaceIndex() = default;
  /// @param radius of the straight cylinder [m], > 0
  SurfaceIndex(const std::vector<SurfacePosition>& points, double radius);

  /// The K nearest points, ties in the order of s.
  template <std::size_t K>
  Nearest<K> nearest(const SurfacePosition& query) const {
    return nearestWithin<K>(query, std::numeric_limits<double>::infinity());
  }

  /// The K nearest points nearer than `reach` [m].
  template <std::size_t K>
  Nearest<K> nearestWithin(const SurfacePosition& query, double reach) const {
    Nearest<K> found;
    found.squared_distance.fill(reach * reach);
    const Eigen::Vector3d center = embed(query);
    const auto start = lowerBound(query.s);
    for (std::size_t up = start, down = start; up < points_.size() || down > 0;) {
      const double above = up < points_.size() ? points_[up].z() - query.s : kInfinity;
      const double below = down > 0 ? query.s - points_[down - 1].z() : kInfinity;
      const double step = std::min(above, below);
      if (step * step >= found.squared_distance[K - 1]) break;
      const std::size_t i = above <= below ? up++ : --down;
      insert(found, order_[i], (points_[i] - center).squaredNorm());
    }
    for (std::size_t k = found.count; k < K; ++k) found.squared_distance[k] = kInfinity;
    return found;
  }

  /// Calls visit(index, squared distance) for every point within `reach` [m], in order of s.
  template <class Visit>
  void forEachWithin(const SurfacePosition& query, double reach, Visit&& visit) const {
    const Eigen::Vector3d center = embed(query);
    for (std::size_t i = lowerBound(query.s - reach);
         i < points_.size() && points_[i].z() <= query.s + reach; ++i) {
      const double squared_distance = (points_[i] - center).squaredNorm();
      if (squared_distance <= reach * reach) visit(order_[i], squared_distance);
    }
  }

  /// Position on the straight cylinder.
  Eigen::Vector3d embed(const SurfacePosition& p) const {
    return {radius_ * std::cos(p.theta), radius_ * std::sin(p.theta), p.s};
  }

  std::size_t size() const { return points_.size(); }
  double radius() const { return radius_; }

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  std::size_t lowerBound(double s) const {
    const auto first =
        std::lower_bound(points_.begin(), points_.end(), s,
                         [](const Eigen::Vector3d& p, double value) { return p.z() < value; });
    return static_cast<std::size_t>(first - points_.begin());
  }

  template <std::size_t K>
  static void insert(Nearest<K>& found, std::uint32_t index, double squared_distance) {
    if (squared_distance >= found.squared_distance[K - 1]) return;
    std::size_t k = K - 1;
    for (; k > 0 && found.squared_distance[k - 1] > squared_distance; --k) {
      found.squared_distance[k] = found.squared_distance[k - 1];
      found.index[k] = found.index[k - 1];
    }
    found.squared_distance[k] = squared_distance;
    found.index[k] = index;
    found.count = std::min(found.count + 1, K);
  }

  double radius_ = 1.0;
  std::vector<std::uint32_t> order_;
  std::vector<Eigen::Vector3d> points_;  // on the straight cylinder, in order of s
};

}  // namespace field_phenotyping
