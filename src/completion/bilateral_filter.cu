#include <algorithm>
#include <cstddef>
#include <vector>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "completion/bilateral_filter_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kLeastThreads = 32U;
constexpr unsigned kMostThreads = 128U;  // 32 rows at once, about as many as a region has

/// Where what belongs to one filter begins.
struct Begin {
  std::size_t point;
  std::size_t kernel;
  std::size_t sum;
  std::size_t node;
};

/// Of all filters, one after the other.
struct DeviceMemoryOfFilters {
  const FilterTask* tasks;  // their pointers are not used
  const Begin* begins;
  const FilterPoint* points;
  const double* kernels;  // of each filter: along the stem, round it
  double* weights;
  double* values;
  FilterColor* sum_colors;
  unsigned char* is_read;
  FilterNode* nodes;
  FilterColor* colors;
};

/// One thread block for each filter.
__global__ void __launch_bounds__(kMostThreads) solveFilters(DeviceMemoryOfFilters memory) {
  extern __shared__ double rows[];
  FilterTask task = memory.tasks[blockIdx.x];
  const Begin& begin = memory.begins[blockIdx.x];
  task.points = memory.points + begin.point;
  task.along = memory.kernels + begin.kernel;
  task.around = task.along + task.reach_along + 1;
  const GpuTeam team;
  FilterSolver<GpuTeam>(team, task,
                        {memory.weights + begin.sum, memory.values + begin.sum,
                         memory.sum_colors + begin.sum, memory.is_read + begin.sum, rows})
      .run(memory.nodes + begin.node, memory.colors + begin.node);
}

}  // namespace

GpuFilters filtersOnGpu(GpuStream& stream, const std::vector<FilterTask>& tasks) {
  std::vector<Begin> begins;
  std::vector<double> kernels;
  GpuFilters result{};
  std::size_t points = 0U;
  std::size_t sums = 0U;
  std::size_t nodes = 0U;
  std::size_t widest = 0U;
  bool by_color = false;
  for (const FilterTask& task : tasks) {
    begins.push_back({points, kernels.size(), sums, nodes});
    result.begins.push_back(nodes);
    kernels.insert(kernels.end(), task.along, task.along + task.reach_along + 1);
    kernels.insert(kernels.end(), task.around, task.around + task.reach_around + 1);
    points += static_cast<std::size_t>(task.count);
    sums += static_cast<std::size_t>(task.sums());
    nodes += static_cast<std::size_t>(task.grid.nodes());
    widest = std::max(widest, static_cast<std::size_t>(task.wideRow()));
    by_color = by_color || task.by_color;
  }
  auto* const all_points = stream.pinned<FilterPoint>(points);
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    std::copy_n(tasks[k].points, tasks[k].count, all_points + begins[k].point);
  }
  DeviceMemoryOfFilters memory{};
  memory.tasks = stream.toDevice(tasks.data(), tasks.size());
  memory.begins = stream.toDevice(begins.data(), begins.size());
  memory.points = stream.pinnedToDevice(all_points, points);
  memory.kernels = stream.toDevice(kernels.data(), kernels.size());
  memory.weights = stream.device<double>(sums);
  memory.values = stream.device<double>(sums);
  memory.sum_colors = stream.device<FilterColor>(sums);
  memory.is_read = stream.device<unsigned char>(sums);
  memory.nodes = stream.device<FilterNode>(nodes);
  memory.colors = stream.device<FilterColor>(nodes);
  // Fewer rows at once where they are wide.
  const std::size_t most_bytes = allowSharedMemory(solveFilters);
  const auto nearBytes = [&](unsigned threads) {
    return threads / kLanes * widest * sizeof(double);
  };
  unsigned threads = kMostThreads;
  while (threads > kLeastThreads && nearBytes(threads) > most_bytes) threads /= 2U;
  solveFilters<<<static_cast<unsigned>(tasks.size()), threads, nearBytes(threads), stream.get()>>>(
      memory);
  checkLaunch("filters of stems");
  result.nodes = stream.toHost(memory.nodes, nodes);
  if (by_color) result.colors = stream.toHost(memory.colors, nodes);
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
