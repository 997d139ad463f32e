#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "measurement/outermost_heights_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 128U;  // a plant has some thousands of points

/// One thread block for each end of a plant.
__global__ void __launch_bounds__(kThreads)
    findEnds(const PlantEndTask* tasks, const float* xyz, OutermostHeights* results) {
  __shared__ OutermostHeights found[kThreads];
  findOutermostHeights(GpuTeam(), tasks[blockIdx.x], xyz, found);
  if (threadIdx.x == 0U) results[blockIdx.x] = found[0];
}

}  // namespace

const OutermostHeights* outermostHeightsOnGpu(GpuStream& stream, const float* xyz,
                                              std::size_t points,
                                              const std::vector<PlantEndTask>& tasks) {
  const float* device_xyz = stream.toDevice(xyz, 3U * points);
  const PlantEndTask* device_tasks = stream.toDevice(tasks.data(), tasks.size());
  auto* results = stream.device<OutermostHeights>(tasks.size());
  findEnds<<<static_cast<unsigned>(tasks.size()), kThreads, 0U, stream.get()>>>(
      device_tasks, device_xyz, results);
  checkLaunch("ends of plants");
  const OutermostHeights* on_host = stream.toHost(results, tasks.size());
  stream.wait();
  return on_host;
}

}  // namespace field_phenotyping
