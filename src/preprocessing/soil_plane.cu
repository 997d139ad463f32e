#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "preprocessing/soil_plane_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 128U;

/// One thread block for each plane.
__global__ void scorePlanes(const SoilPlane* planes, SoilCandidates candidates, float tolerance,
                            int* scores) {
  __shared__ int scratch[kThreads / kLanes];
  const int score = scorePlane(GpuTeam(), planes[blockIdx.x], candidates, tolerance, scratch);
  if (threadIdx.x == 0U) scores[blockIdx.x] = score;
}

}  // namespace

const int* planeScoresOnGpu(GpuStream& stream, const SoilPlane* planes, std::uint32_t count,
                            const SoilCandidates& candidates, float tolerance) {
  const SoilCandidates on_device{stream.toDevice(candidates.x, candidates.count),
                                 stream.toDevice(candidates.y, candidates.count),
                                 stream.toDevice(candidates.z, candidates.count), candidates.count};
  const SoilPlane* device_planes = stream.toDevice(planes, count);
  int* scores = stream.device<int>(count);
  scorePlanes<<<count, kThreads, 0, stream.get()>>>(device_planes, on_device, tolerance, scores);
  checkLaunch("scores of soil planes");
  const int* result = stream.toHost(scores, count);
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
