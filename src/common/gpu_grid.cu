#include "common/gpu_grid.hpp"
#include "common/gpu_sort.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 256U;

unsigned blocksFor(std::uint64_t items) {
  return static_cast<unsigned>((items + kThreads - 1U) / kThreads);
}

__device__ std::uint64_t itemOfThread() {
  return static_cast<std::uint64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
}

/// A number for each cell, by which points are sorted: rows as in NeighborGrid, then along the row.
struct CellKey {
  GridGeometry geometry;

  __host__ __device__ std::uint64_t cellsInRow() const {
    return static_cast<std::uint64_t>(geometry.last[0]) + 1U;
  }
  __device__ std::uint64_t of(const Place& p) const {
    const std::uint64_t row = geometry.rowOf(geometry.cellOf(p.y, 1), geometry.cellOf(p.z, 2));
    return row * cellsInRow() + static_cast<std::uint64_t>(geometry.cellOf(p.x, 0));
  }
  __device__ std::uint64_t rowOf(std::uint64_t key) const { return key / cellsInRow(); }
  __device__ int cellXOf(std::uint64_t key) const { return static_cast<int>(key % cellsInRow()); }
  /// Bits that keys differ in.
  int bits() const {
    const std::uint64_t rows =
        geometry.rows_y * (static_cast<std::uint64_t>(geometry.last[2]) + 1U);
    const std::uint64_t highest = rows * cellsInRow() - 1U;
    int bits = 1;
    while (bits < 64 && (highest >> bits) != 0U) ++bits;
    return bits;
  }
};

__global__ void numberPoints(CellKey key, const Place* points, std::uint32_t count,
                             std::uint64_t* keys, std::uint32_t* indices) {
  const std::uint64_t i = itemOfThread();
  if (i >= count) return;
  keys[i] = key.of(points[i]);
  indices[i] = static_cast<std::uint32_t>(i);
}

struct SortedPoints {
  float* x;
  float* y;
  float* z;
  int* cell_x;
  std::uint64_t* row;
};

__global__ void placePoints(CellKey key, const Place* points, const std::uint64_t* keys,
                            const std::uint32_t* order, std::uint32_t count, SortedPoints sorted,
                            std::uint32_t* cells) {
  const std::uint64_t k = itemOfThread();
  if (k >= count) return;
  const Place p = points[order[k]];
  sorted.x[k] = p.x;
  sorted.y[k] = p.y;
  sorted.z[k] = p.z;
  sorted.cell_x[k] = key.cellXOf(keys[k]);
  sorted.row[k] = key.rowOf(keys[k]);
  if (k == 0U || keys[k] != keys[k - 1U]) atomicAdd(cells, 1U);
}

/// Where each bucket begins: at the first sorted point that is of it or of one after it.
__global__ void findBuckets(GridGeometry geometry, SortedPoints sorted, std::uint32_t count,
                            std::uint32_t* begin) {
  const std::uint64_t bucket = itemOfThread();
  if (bucket > geometry.buckets) return;
  std::uint32_t low = 0U;
  std::uint32_t high = count;
  while (low < high) {
    const std::uint32_t middle = low + (high - low) / 2U;
    if (geometry.bucketOf(sorted.cell_x[middle], sorted.row[middle]) < bucket) {
      low = middle + 1U;
    } else {
      high = middle;
    }
  }
  begin[bucket] = low;
}

}  // namespace

GpuGrid buildGpuGrid(GpuStream& stream, const Place* points, std::uint32_t count,
                     const GridGeometry& geometry) {
  GpuGrid grid;
  grid.view.geometry = geometry;
  if (count == 0U) return grid;
  const CellKey key{geometry};
  auto* keys = stream.device<std::uint64_t>(count);
  auto* sorted_keys = stream.device<std::uint64_t>(count);
  auto* indices = stream.device<std::uint32_t>(count);
  auto* order = stream.device<std::uint32_t>(count);
  numberPoints<<<blocksFor(count), kThreads, 0, stream.get()>>>(key, points, count, keys, indices);
  checkLaunch("numbering of points");

  // Stable: points of one cell stay in the order of their indices.
  sortOnGpu(stream, keys, sorted_keys, indices, order, count, key.bits());

  const std::size_t padded = count + kLanes;
  const SortedPoints sorted{stream.device<float>(padded), stream.device<float>(padded),
                            stream.device<float>(padded), stream.device<int>(count),
                            stream.device<std::uint64_t>(count)};
  auto* cells = stream.device<std::uint32_t>(1U);
  checkGpu(cudaMemsetAsync(cells, 0, sizeof *cells, stream.get()), "clearing of a counter");
  placePoints<<<blocksFor(count), kThreads, 0, stream.get()>>>(key, points, sorted_keys, order,
                                                               count, sorted, cells);
  checkLaunch("placing of sorted points");
  if (geometry.has_table) {
    auto* begin = stream.device<std::uint32_t>(geometry.buckets + 1U);
    findBuckets<<<blocksFor(geometry.buckets + 1U), kThreads, 0, stream.get()>>>(geometry, sorted,
                                                                                 count, begin);
    checkLaunch("search for buckets");
    grid.view.begin = begin;
  }
  grid.view.size = count;
  grid.view.x = sorted.x;
  grid.view.y = sorted.y;
  grid.view.z = sorted.z;
  grid.view.order = order;
  grid.view.cell_x = sorted.cell_x;
  grid.view.row = sorted.row;
  const std::uint32_t* host_cells = stream.toHost(cells, 1U);
  stream.wait();
  grid.cells = *host_cells;
  return grid;
}

}  // namespace field_phenotyping
