#include "common/gpu_sort.hpp"
#include "common/gpu_stream.hpp"
#include "preprocessing/voxel_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 256U;
constexpr int kKeyBits = 63;
constexpr int kIndexBits = 32;

unsigned blocksFor(std::uint32_t items) {
  return (items - 1U) / kThreads + 1U;
}

__device__ std::uint64_t itemOfThread() {
  return static_cast<std::uint64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
}

__global__ void keyPoints(const Place* points, std::uint32_t count, float voxel_size,
                          std::uint64_t* keys, std::uint32_t* indices) {
  const std::uint64_t i = itemOfThread();
  if (i >= count) return;
  keys[i] = voxelKeyOf(points[i], voxel_size);
  indices[i] = static_cast<std::uint32_t>(i);
}

/// Flags each sorted point that is the first of its voxel.
__global__ void flagFirst(const std::uint64_t* keys, std::uint32_t count, std::uint8_t* is_first) {
  const std::uint64_t k = itemOfThread();
  if (k >= count) return;
  is_first[k] = k == 0U || keys[k] != keys[k - 1U] ? 1U : 0U;
}

/// When each voxel, in the order of keys, was opened: at its first point.
__global__ void findOpening(const std::uint32_t* begin, const std::uint32_t* order,
                            std::uint32_t voxels, std::uint64_t* opening, std::uint32_t* indices) {
  const std::uint64_t v = itemOfThread();
  if (v >= voxels) return;
  opening[v] = order[begin[v]];
  indices[v] = static_cast<std::uint32_t>(v);
}

/// One thread for each voxel, in the order of opening.
__global__ void averagePoints(const Place* points, const std::uint64_t* sorted_keys,
                              const std::uint32_t* order, std::uint32_t count,
                              const std::uint32_t* begin, const std::uint32_t* by_opening,
                              std::uint32_t voxels, VoxelMean* means, std::uint64_t* keys) {
  const std::uint64_t k = itemOfThread();
  if (k >= voxels) return;
  const std::uint32_t v = by_opening[k];
  const std::uint32_t end = v + 1U < voxels ? begin[v + 1U] : count;
  means[k] = meanOfSorted(points, order, begin[v], end);
  keys[k] = sorted_keys[begin[v]];
}

}  // namespace

GpuVoxels voxelsOnGpu(GpuStream& stream, const float* xyz, std::uint32_t count, float voxel_size) {
  if (count == 0U) return {nullptr, nullptr, 0U};
  static_assert(sizeof(Place) == 3U * sizeof(float), "points are copied as they are");
  const auto* points =
      reinterpret_cast<const Place*>(stream.toDevice(xyz, 3U * static_cast<std::size_t>(count)));
  auto* keys = stream.device<std::uint64_t>(count);
  auto* sorted_keys = stream.device<std::uint64_t>(count);
  auto* indices = stream.device<std::uint32_t>(count);
  auto* order = stream.device<std::uint32_t>(count);
  keyPoints<<<blocksFor(count), kThreads, 0, stream.get()>>>(points, count, voxel_size, keys,
                                                             indices);
  checkLaunch("keys of voxels");
  sortOnGpu(stream, keys, sorted_keys, indices, order, count, kKeyBits);

  auto* is_first = stream.device<std::uint8_t>(count);
  auto* begin = stream.device<std::uint32_t>(count);
  auto* device_voxels = stream.device<std::uint32_t>(1U);
  flagFirst<<<blocksFor(count), kThreads, 0, stream.get()>>>(sorted_keys, count, is_first);
  checkLaunch("first points of voxels");
  selectOnGpu(stream, indices, is_first, begin, device_voxels, count);
  const std::uint32_t* host_voxels = stream.toHost(device_voxels, 1U);
  stream.wait();
  const std::uint32_t voxels = *host_voxels;

  auto* opening = stream.device<std::uint64_t>(voxels);
  auto* sorted_opening = stream.device<std::uint64_t>(voxels);
  auto* voxel_indices = stream.device<std::uint32_t>(voxels);
  auto* by_opening = stream.device<std::uint32_t>(voxels);
  findOpening<<<blocksFor(voxels), kThreads, 0, stream.get()>>>(begin, order, voxels, opening,
                                                                voxel_indices);
  checkLaunch("order of voxels");
  sortOnGpu(stream, opening, sorted_opening, voxel_indices, by_opening, voxels, kIndexBits);
  auto* means = stream.device<VoxelMean>(voxels);
  auto* voxel_keys = stream.device<std::uint64_t>(voxels);
  averagePoints<<<blocksFor(voxels), kThreads, 0, stream.get()>>>(
      points, sorted_keys, order, count, begin, by_opening, voxels, means, voxel_keys);
  checkLaunch("means of voxels");
  const GpuVoxels result{stream.toHost(means, voxels), stream.toHost(voxel_keys, voxels), voxels};
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
