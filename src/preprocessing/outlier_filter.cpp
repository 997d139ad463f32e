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

/// Whether the points next to the k-th in the grid's order are neighbours enough: a quick look that
/// settles most.
bool crowdInOrder(const NeighborGrid& grid, const PointCloud& cloud, std::size_t k, float radius,
                  std::uint32_t wanted) {
  constexpr std::size_t kLook = 4U;  // points on either side
  const std::size_t end = std::min(k + kLook + 1U, grid.size());
  const Eigen::Vector3f& point = cloud.points[grid.sorted(k)];
  std::uint32_t found = 0U;
  for (std::size_t other = k - std::min(k, kLook); other < end; ++other) {
    const Eigen::Vector3f offset = cloud.points[grid.sorted(other)] - point;
    if (offset.squaredNorm() <= radius * radius) ++found;
  }
  return found >= wanted;
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
  // The point finds itself.
  const auto wanted = static_cast<std::uint32_t>(min_neighbors) + 1U;
  for (std::size_t k = 0; k < grid.size(); ++k) {
    const std::uint32_t i = grid.sorted(k);
    const bool kept = crowdInOrder(grid, cloud, k, radius, wanted) ||
                      grid.hasWithin(cloud.points[i], radius, wanted);
    keep[i] = kept ? 1U : 0U;
  }
  return keep;
}

}  // namespace field_phenotyping
