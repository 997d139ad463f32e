#include <algorithm>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "segmentation/leaf_search_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 256U;  // 64 bases at once, about as many as a stem begins with

/// Memory of all stems, one after the other.
struct DeviceMemoryOfLeaves {
  const LeafSearchTask* tasks;  // their pointers are not used
  const std::size_t* point_begins;
  const std::size_t* guess_begins;
  const float* values;  // of each stem: arc lengths, azimuths, distances, radii, densities
  const LeafBase* guesses;
  float* scratch;        // for each point 2
  LeafBase* candidates;  // for each guess 2
  LeafBase* found;       // for each guess
  int* kept;             // likewise
  int* counts;           // of those found, for each stem
};
constexpr std::size_t kValues = 5U;  // of each point

/// One thread block for each stem.
__global__ void __launch_bounds__(kThreads) findLeaves(DeviceMemoryOfLeaves memory) {
  __shared__ int count;
  const unsigned s = blockIdx.x;
  LeafSearchTask task = memory.tasks[s];
  const std::size_t padded = static_cast<std::size_t>(task.count) + kLanes;
  const std::size_t guesses = memory.guess_begins[s];
  const float* values = memory.values + kValues * memory.point_begins[s];
  float* scratch = memory.scratch + 2U * memory.point_begins[s];
  task.arc_lengths = values;
  task.azimuths = values + padded;
  task.distances = values + 2U * padded;
  task.radii = values + 3U * padded;
  task.stem = values + 4U * padded;
  task.guesses = memory.guesses + guesses;
  LeafBase* candidates = memory.candidates + 2U * guesses;
  LeafSearch<GpuTeam> search(GpuTeam(), task,
                             {scratch, scratch + padded, candidates, candidates + task.guess_count,
                              memory.found + guesses, memory.kept + guesses, &count});
  const int found = search.find();
  if (threadIdx.x == 0U) memory.counts[s] = found;
}

}  // namespace

GpuLeafBases leafBasesOnGpu(GpuStream& stream, const std::vector<LeafSearchTask>& tasks) {
  std::vector<std::size_t> point_begins;
  GpuLeafBases result{};
  std::vector<LeafBase> guesses;
  std::size_t points = 0U;
  for (const LeafSearchTask& task : tasks) {
    point_begins.push_back(points);
    result.begins.push_back(guesses.size());
    points += static_cast<std::size_t>(task.count) + kLanes;
    guesses.insert(guesses.end(), task.guesses, task.guesses + task.guess_count);
  }
  auto* const values = stream.pinned<float>(kValues * points);
  float* next = values;
  for (const LeafSearchTask& task : tasks) {
    const std::size_t padded = static_cast<std::size_t>(task.count) + kLanes;
    for (const float* of_points :
         {task.arc_lengths, task.azimuths, task.distances, task.radii, task.stem}) {
      next = std::copy_n(of_points, padded, next);
    }
  }
  DeviceMemoryOfLeaves memory{};
  memory.tasks = stream.toDevice(tasks.data(), tasks.size());
  memory.point_begins = stream.toDevice(point_begins.data(), point_begins.size());
  memory.guess_begins = stream.toDevice(result.begins.data(), result.begins.size());
  memory.values = stream.pinnedToDevice(values, kValues * points);
  memory.guesses = stream.toDevice(guesses.data(), guesses.size());
  memory.scratch = stream.device<float>(2U * points);
  memory.candidates = stream.device<LeafBase>(2U * guesses.size());
  LeafBase* found = stream.device<LeafBase>(guesses.size());
  memory.found = found;
  memory.kept = stream.device<int>(guesses.size());
  int* counts = stream.device<int>(tasks.size());
  memory.counts = counts;
  findLeaves<<<static_cast<unsigned>(tasks.size()), kThreads, 0U, stream.get()>>>(memory);
  checkLaunch("search for leaf bases");
  result.bases = stream.toHost(found, guesses.size());
  result.counts = stream.toHost(counts, tasks.size());
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
