#include "field_phenotyping/preprocessing/outlier_filter.hpp"

#include <algorithm>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {
namespace {

int countNeighbors(const NeighborGrid& grid, const Eigen::Vector3f& point, float radius) {
  int count = -1;  // the point finds itself
  grid.forEachWithin(point, radius, [&](std::uint32_t, float) { ++count; });
  return count;
}

int medianNeighborCount(const NeighborGrid& grid, const PointCloud& cloud, float radius) {
  constexpr std::size_t kSamples = 400U;
  const std::size_t step = std::max<std::size_t>(1U, cloud.size() / kSamples);
  std::vector<int> counts;
  for (std::size_t i = 0; i < cloud.size(); i += step) {
    counts.push_back(countNeighbors(grid, cloud.points[i], radius));
  }
  return medianOf(std::move(counts));
}

}  // namespace

std::vector<std::uint8_t> radiusOutlierFilter(const PointCloud& cloud, float radius,
                                              int min_neighbors) {
  std::vector<std::uint8_t> keep(cloud.size(), 1U);
  if (min_neighbors <= 0 || cloud.empty()) return keep;

  constexpr int kMaxDoublings = 3;
  NeighborGrid grid(cloud.points, radius);
  for (int doubling = 0; doubling < kMaxDoublings; ++doubling) {
    if (medianNeighborCount(grid, cloud, radius) >= 2 * min_neighbors) break;
    radius *= 2.0F;
    grid = NeighborGrid(cloud.points, radius);
  }
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    // The point finds itself.
    const auto wanted = static_cast<std::uint32_t>(min_neighbors) + 1U;
    keep[i] = grid.hasWithin(cloud.points[i], radius, wanted) ? 1U : 0U;
  }
  return keep;
}

}  // namespace field_phenotyping
