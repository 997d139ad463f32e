#include "field_phenotyping/preprocessing/outlier_filter.hpp"

#include <algorithm>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/preprocessing/outlier_filter_team.hpp"
#include "preprocessing/outlier_filter_gpu.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

/// The filter's searches on the CPU.
class CpuSearch {
 public:
  explicit CpuSearch(const Points& points) : points_(points), grid_({}, 1.0F) {}

  void build(float radius) { grid_ = NeighborGrid(points_, radius); }

  std::vector<std::uint32_t> sampleCounts(float radius, std::uint32_t step) const {
    std::vector<std::uint32_t> counts;
    const GridView view = grid_.view();
    for (std::size_t i = 0; i < points_.size(); i += step) {
      counts.push_back(countWithin(VectorLanes(), view, NeighborGrid::placeOf(points_[i]), radius,
                                   view.size + 1U));
    }
    return counts;
  }

  std::vector<std::uint8_t> company(float radius, std::uint32_t wanted) const {
    std::vector<std::uint8_t> company(points_.size());
    const GridView view = grid_.view();
    constexpr std::size_t kChunk = 16384U;  // points of a task
    parallelChunks(view.size, kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const auto at = static_cast<std::uint32_t>(k);
        company[view.order[k]] = hasCompany(VectorLanes(), view, at, radius, wanted) ? 1U : 0U;
      }
    });
    return company;
  }

 private:
  const Points& points_;
  NeighborGrid grid_;
};

/// The same on the GPU.
class GpuSearch {
 public:
  GpuSearch(GpuStream& stream, const Points& points)
      : points_(points),
        search_(stream, xyzOf(points), static_cast<std::uint32_t>(points.size())) {}

  void build(float radius) { search_.build(gridGeometry(points_, radius)); }

  std::vector<std::uint32_t> sampleCounts(float radius, std::uint32_t step) {
    const std::uint32_t* counts = search_.sampleCounts(radius, step);
    return {counts, counts + (points_.size() - 1U) / step + 1U};
  }

  std::vector<std::uint8_t> company(float radius, std::uint32_t wanted) {
    const std::uint8_t* company = search_.company(radius, wanted);
    return {company, company + points_.size()};
  }

 private:
  const Points& points_;
  GpuNeighborSearch search_;
};

template <class Search>
std::vector<std::uint8_t> filter(Search& search, std::size_t points, float radius,
                                 std::uint32_t min_neighbors) {
  constexpr std::size_t kSamples = 400U;
  const auto step = static_cast<std::uint32_t>(std::max<std::size_t>(1U, points / kSamples));
  constexpr int kMaxDoublings = 3;
  search.build(radius);
  for (int doubling = 0; doubling < kMaxDoublings; ++doubling) {
    // The point finds itself.
    const std::uint32_t typical = medianOf(search.sampleCounts(radius, step)) - 1U;
    if (typical >= 2U * min_neighbors) break;
    radius *= 2.0F;
    search.build(radius);
  }
  return search.company(radius, min_neighbors + 1U);
}

}  // namespace

std::vector<std::uint8_t> radiusOutlierFilter(const PointCloud& cloud, float radius,
                                              int min_neighbors, const ComputeDevice& device) {
  std::vector<std::uint8_t> keep(cloud.size(), 1U);
  if (min_neighbors <= 0 || cloud.empty()) return keep;
  const auto wanted = static_cast<std::uint32_t>(min_neighbors);
  if constexpr (kWithCuda) {
    const bool done = device.attempt([&](GpuStream& stream) {
      GpuSearch search(stream, cloud.points);
      keep = filter(search, cloud.size(), radius, wanted);
    });
    if (done) return keep;
  }
  CpuSearch search(cloud.points);
  return filter(search, cloud.size(), radius, wanted);
}

}  // namespace field_phenotyping
