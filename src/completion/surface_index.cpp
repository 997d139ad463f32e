#include "field_phenotyping/completion/surface_index.hpp"

#include <algorithm>
#include <numeric>

namespace field_phenotyping {

SurfaceIndex::SurfaceIndex(const std::vector<SurfacePosition>& points, double radius)
    : radius_(radius), order_(points.size()) {
  std::iota(order_.begin(), order_.end(), 0U);
  std::sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
    return points[a].s != points[b].s ? points[a].s < points[b].s : a < b;
  });
  points_.reserve(points.size());
  for (const std::uint32_t i : order_) points_.push_back(embed(points[i]));
}

}  // namespace field_phenotyping
