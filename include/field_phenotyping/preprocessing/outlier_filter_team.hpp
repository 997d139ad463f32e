#pragma once

#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// What radiusOutlierFilter() asks of each point, for the lanes of a team (see team.hpp), on the CPU
// and on the GPU.

/// Whether at least `wanted` points, itself included, lie within `radius` [m] of the k-th sorted
/// point.
template <class Lanes>
FIELD_PHENOTYPING_HD bool hasCompany(const Lanes& lanes, const GridView& grid, std::uint32_t k,
                                     float radius, std::uint32_t wanted) {
  const Place center{grid.x[k], grid.y[k], grid.z[k]};
  // The points next to it in the grid's order settle most.
  constexpr std::uint32_t kLook = 4U;  // on either side
  const std::uint32_t begin = k < kLook ? 0U : k - kLook;
  const std::uint32_t end = grid.size - k <= kLook ? grid.size : k + kLook + 1U;
  std::uint32_t found = 0U;
  for (std::uint32_t other = begin; other < end; ++other) {
    const float x = grid.x[other] - center.x;
    const float y = grid.y[other] - center.y;
    const float z = grid.z[other] - center.z;
    if (x * x + (y * y + z * z) <= radius * radius) ++found;
  }
  return found >= wanted || countWithin(lanes, grid, center, radius, wanted) >= wanted;
}

}  // namespace field_phenotyping
