#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/vector3.hpp"

namespace field_phenotyping {

/// The K points nearest to a place.
template <std::size_t K>
struct NearestOnSurface {
  std::uint32_t index[K] = {};  ///< nearest first
  double squared_distance[K];   ///< [m^2]; infinite where there are fewer points
  std::size_t count = 0;
};

/// The points of a SurfaceIndex, which owns them, for the CPU and the GPU: on a straight cylinder
/// along z, in order of z. Indices are places in that order.
struct SurfaceIndexView {
  const Vector3* points;
  std::size_t count;

  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  /// The K nearest points nearer than `reach` [m], ties in the order of z. A query walks away from
  /// its own z until nothing nearer can follow.
  template <std::size_t K>
  FIELD_PHENOTYPING_HD NearestOnSurface<K> nearestWithin(const Vector3& center,
                                                         double reach) const {
    NearestOnSurface<K> found;
    for (std::size_t k = 0; k < K; ++k) found.squared_distance[k] = reach * reach;
    const std::size_t start = lowerBound(center.z());
    for (std::size_t up = start, down = start; up < count || down > 0;) {
      const double above = up < count ? points[up].z() - center.z() : kInfinity;
      const double below = down > 0 ? center.z() - points[down - 1].z() : kInfinity;
      const double step = smallerOf(above, below);
      if (step * step >= found.squared_distance[K - 1]) break;
      const std::size_t i = above <= below ? up++ : --down;
      insert(found, i, (points[i] - center).squaredNorm());
    }
    for (std::size_t k = found.count; k < K; ++k) found.squared_distance[k] = kInfinity;
    return found;
  }

  /// Calls visit(index, squared distance) for every point within `reach` [m], in order of z.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forEachWithin(const Vector3& center, double reach,
                                          Visit&& visit) const {
    for (std::size_t i = lowerBound(center.z() - reach);
         i < count && points[i].z() <= center.z() + reach; ++i) {
      const double squared_distance = (points[i] - center).squaredNorm();
      if (squared_distance <= reach * reach) visit(i, squared_distance);
    }
  }

  /// Number of the first point at z or above.
  FIELD_PHENOTYPING_HD std::size_t lowerBound(double z) const {
    std::size_t low = 0;
    std::size_t high = count;
    while (low < high) {
      const std::size_t middle = low + (high - low) / 2;
      if (points[middle].z() < z) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    return low;
  }

 private:
  template <std::size_t K>
  FIELD_PHENOTYPING_HD static void insert(NearestOnSurface<K>& found, std::size_t index,
                                          double squared_distance) {
    if (squared_distance >= found.squared_distance[K - 1]) return;
    std::size_t k = K - 1;
    for (; k > 0 && found.squared_distance[k - 1] > squared_distance; --k) {
      found.squared_distance[k] = found.squared_distance[k - 1];
      found.index[k] = found.index[k - 1];
    }
    found.squared_distance[k] = squared_distance;
    found.index[k] = static_cast<std::uint32_t>(index);
    found.count = found.count < K ? found.count + 1 : K;
  }
};

}  // namespace field_phenotyping
