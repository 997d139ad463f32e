#include "common/gpu_grid.hpp"
#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "segmentation/local_shape_gpu.hpp"

namespace field_phenotyping {
namespace {

/// The same tile for every cell: shared memory.
struct SharedTile {
  CandidateTile tile;
  FIELD_PHENOTYPING_HD CandidateTile operator()(std::uint32_t /*candidates*/) const { return tile; }
};

struct StoreInSourceOrder {
  const std::uint32_t* order;
  LocalShapeNumbers* shapes;
  FIELD_PHENOTYPING_HD void operator()(std::uint32_t k, const Moments& moments) const {
    shapes[order[k]] = localShapeOf(moments);
  }
};

constexpr std::uint32_t kTile = 512U;  // candidates: three times 2 KiB of shared memory

/// One thread block for `chunk` sorted points.
__global__ void shapePoints(GridView grid, std::uint32_t chunk, float radius,
                            LocalShapeNumbers* shapes) {
  __shared__ float x[kTile + kLanes];
  __shared__ float y[kTile + kLanes];
  __shared__ float z[kTile + kLanes];
  const std::uint32_t begin = blockIdx.x * chunk;
  const std::uint32_t end = grid.size - begin < chunk ? grid.size : begin + chunk;
  shapeMomentsOfChunk(GpuTeam(), grid, begin, end, radius, SharedTile{{x, y, z, kTile}},
                      StoreInSourceOrder{grid.order, shapes});
}

}  // namespace

const LocalShapeNumbers* localShapesOnGpu(GpuStream& stream, const float* xyz, std::uint32_t count,
                                          const GridGeometry& geometry, float radius) {
  if (count == 0U) return nullptr;
  static_assert(sizeof(Place) == 3U * sizeof(float), "points are copied as they are");
  const auto* points =
      reinterpret_cast<const Place*>(stream.toDevice(xyz, 3U * static_cast<std::size_t>(count)));
  const GpuGrid grid = buildGpuGrid(stream, points, count, geometry);
  auto* shapes = stream.device<LocalShapeNumbers>(count);

  // As many groups as a usual cell has points, for they have their candidates in common.
  const std::uint32_t points_in_cell = count / grid.cells + 1U;
  constexpr std::uint32_t kLeastThreads = 32U;
  constexpr std::uint32_t kMostThreads = 256U;
  std::uint32_t threads = kLeastThreads;
  while (threads < kMostThreads && threads < points_in_cell * kLanes) threads *= 2U;
  constexpr std::uint32_t kLeastChunk = 32U;
  const std::uint32_t chunk = points_in_cell < kLeastChunk ? kLeastChunk : points_in_cell;
  const std::uint32_t blocks = (count - 1U) / chunk + 1U;
  shapePoints<<<blocks, threads, 0, stream.get()>>>(grid.view, chunk, radius, shapes);
  checkLaunch("local shapes");
  const LocalShapeNumbers* result = stream.toHost(shapes, count);
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
