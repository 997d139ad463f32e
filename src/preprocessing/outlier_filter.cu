#include "common/gpu_grid.hpp"
#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "field_phenotyping/preprocessing/outlier_filter_team.hpp"
#include "preprocessing/outlier_filter_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kThreads = 128U;
constexpr std::uint32_t kGroups = kThreads / static_cast<std::uint32_t>(kLanes);

/// One group of lanes for each item.
__device__ std::uint64_t itemOfGroup() {
  return static_cast<std::uint64_t>(blockIdx.x) * kGroups + GpuTeam::group();
}
unsigned blocksFor(std::uint32_t items) {
  return (items - 1U) / kGroups + 1U;
}

__global__ void countAroundSamples(GridView grid, const Place* points, std::uint32_t step,
                                   std::uint32_t samples, float radius, std::uint32_t* counts) {
  const std::uint64_t sample = itemOfGroup();
  if (sample >= samples) return;
  const GpuLanes lanes = GpuTeam::lanes();
  const std::uint32_t count = countWithin(lanes, grid, points[sample * step], radius, 0xFFFFFFFFU);
  if (lanes.first()) counts[sample] = count;
}

__global__ void findCompany(GridView grid, float radius, std::uint32_t wanted,
                            std::uint8_t* company) {
  const std::uint64_t k = itemOfGroup();
  if (k >= grid.size) return;
  const GpuLanes lanes = GpuTeam::lanes();
  const bool has = hasCompany(lanes, grid, static_cast<std::uint32_t>(k), radius, wanted);
  if (lanes.first()) company[grid.order[k]] = has ? 1U : 0U;
}

}  // namespace

GpuNeighborSearch::GpuNeighborSearch(GpuStream& stream, const float* xyz, std::uint32_t count)
    : stream_(stream), count_(count) {
  static_assert(sizeof(Place) == 3U * sizeof(float), "points are copied as they are");
  points_ =
      reinterpret_cast<const Place*>(stream.toDevice(xyz, 3U * static_cast<std::size_t>(count)));
}

void GpuNeighborSearch::build(const GridGeometry& geometry) {
  grid_ = buildGpuGrid(stream_, points_, count_, geometry).view;
}

const std::uint32_t* GpuNeighborSearch::sampleCounts(float radius, std::uint32_t step) {
  const std::uint32_t samples = (count_ - 1U) / step + 1U;
  auto* counts = stream_.device<std::uint32_t>(samples);
  countAroundSamples<<<blocksFor(samples), kThreads, 0, stream_.get()>>>(grid_, points_, step,
                                                                         samples, radius, counts);
  checkLaunch("counts of neighbours");
  const std::uint32_t* result = stream_.toHost(counts, samples);
  stream_.wait();
  return result;
}

const std::uint8_t* GpuNeighborSearch::company(float radius, std::uint32_t wanted) {
  auto* company = stream_.device<std::uint8_t>(count_);
  findCompany<<<blocksFor(count_), kThreads, 0, stream_.get()>>>(grid_, radius, wanted, company);
  checkLaunch("outliers");
  const std::uint8_t* result = stream_.toHost(company, count_);
  stream_.wait();
  return result;
}

}  // namespace field_phenotyping
