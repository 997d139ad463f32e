#include <algorithm>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "field_phenotyping/segmentation/stem_growth_team.hpp"
#include "segmentation/stem_growth_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 128U;  // 32 regions at once, about as many as a tall stem has
/// What spheres are compared with lies in shared memory, of stems with no more points than fit into
/// what every thread block may have without asking for more.
constexpr std::size_t kNearBytes = std::size_t{40} << 10U;
constexpr std::size_t kNearValues = 5U;  // of each point

/// Where what belongs to one stem begins.
struct Begin {
  std::size_t member;
  std::size_t region;
  std::size_t leaf_base;
  std::size_t node;       // of its axis
  std::size_t direction;  // of a segment of it
  std::size_t memory;     // bytes
};

/// Of all stems, one after the other.
struct DeviceMemoryOfGrowth {
  const GrowthTask* tasks;  // their pointers are not used
  const Begin* begins;
  const Place* points;  // of the members alone
  const LocalShapeNumbers* shapes;
  const GrowthRegionTask* regions;
  const LeafBase* leaf_bases;
  const AxisNode* nodes;
  const float* arc_lengths;  // of nodes
  const Place* directions;
  char* memory;
  growth::Outcome* outcomes;
  growth::RegionResult* results;
  std::uint32_t* kept;  // members
};

FIELD_PHENOTYPING_HD std::size_t nearBytes(const GrowthTask& task) {
  return kNearValues * static_cast<std::size_t>(growth::paddedOf(task.count)) * sizeof(float);
}

/// One thread block for each stem.
__global__ void __launch_bounds__(kThreads) growStemsOfBlock(DeviceMemoryOfGrowth memory) {
  extern __shared__ float near[];
  __shared__ int counts[kThreads];
  __shared__ float values[kThreads];
  // Without its constructor, which shared memory cannot have: the team sets all of it.
  __shared__ alignas(double) char shared_bytes[sizeof(growth::Shared)];
  auto* shared = reinterpret_cast<growth::Shared*>(shared_bytes);
  GrowthTask task = memory.tasks[blockIdx.x];
  const Begin& begin = memory.begins[blockIdx.x];
  task.points = memory.points + begin.member;
  task.shapes = memory.shapes + begin.member;
  task.members = nullptr;
  task.regions = memory.regions + begin.region;
  task.leaf_bases = memory.leaf_bases + begin.leaf_base;
  task.axis.nodes = memory.nodes + begin.node;
  task.axis.arc_lengths = memory.arc_lengths + begin.node;
  task.axis.directions = memory.directions + begin.direction;
  growth::Memory own{};
  growth::cut(task, memory.memory + begin.memory, own);
  own.best = memory.kept + begin.member;
  own.results = memory.results + begin.region;
  if (nearBytes(task) <= kNearBytes) {
    float* at = near;
    for (float** of_points : {&own.x, &own.y, &own.z, &own.similarity, &own.weight}) {
      *of_points = takeFrom(at, growth::paddedOf(task.count));
    }
  }
  StemGrowth<GpuTeam> stem(GpuTeam(), task, own, {shared, counts, values});
  stem.growStem();
  if (threadIdx.x == 0U) memory.outcomes[blockIdx.x] = shared->outcome;
}

}  // namespace

GpuGrowth growStemsOnGpu(GpuStream& stream, const std::vector<GrowthTask>& tasks) {
  std::vector<Begin> begins;
  std::vector<GrowthRegionTask> regions;
  std::vector<LeafBase> leaf_bases;
  std::vector<AxisNode> nodes;
  std::vector<float> arc_lengths;
  std::vector<Place> directions;
  std::size_t members = 0U;
  std::size_t bytes = 0U;
  std::size_t near_bytes = 0U;
  for (const GrowthTask& task : tasks) {
    begins.push_back(
        {members, regions.size(), leaf_bases.size(), nodes.size(), directions.size(), bytes});
    members += static_cast<std::size_t>(task.count);
    regions.insert(regions.end(), task.regions, task.regions + task.region_count);
    leaf_bases.insert(leaf_bases.end(), task.leaf_bases, task.leaf_bases + task.base_count);
    const AxisView& axis = task.axis;
    nodes.insert(nodes.end(), axis.nodes, axis.nodes + axis.segments + 1);
    arc_lengths.insert(arc_lengths.end(), axis.arc_lengths, axis.arc_lengths + axis.segments + 1);
    directions.insert(directions.end(), axis.directions, axis.directions + axis.segments);
    growth::Memory uncut{};
    bytes += growth::cut(task, nullptr, uncut);
    if (nearBytes(task) <= kNearBytes) near_bytes = std::max(near_bytes, nearBytes(task));
  }
  auto* const points = stream.pinned<Place>(members);
  auto* const shapes = stream.pinned<LocalShapeNumbers>(members);
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    const GrowthTask& task = tasks[k];
    for (int i = 0; i < task.count; ++i) {
      points[begins[k].member + static_cast<std::size_t>(i)] = task.points[task.members[i]];
      shapes[begins[k].member + static_cast<std::size_t>(i)] = task.shapes[task.members[i]];
    }
  }
  DeviceMemoryOfGrowth memory{};
  memory.tasks = stream.toDevice(tasks.data(), tasks.size());
  memory.begins = stream.toDevice(begins.data(), begins.size());
  memory.points = stream.pinnedToDevice(points, members);
  memory.shapes = stream.pinnedToDevice(shapes, members);
  memory.regions = stream.toDevice(regions.data(), regions.size());
  memory.leaf_bases = stream.toDevice(leaf_bases.data(), leaf_bases.size());
  memory.nodes = stream.toDevice(nodes.data(), nodes.size());
  memory.arc_lengths = stream.toDevice(arc_lengths.data(), arc_lengths.size());
  memory.directions = stream.toDevice(directions.data(), directions.size());
  memory.memory = stream.device<char>(bytes);
  memory.outcomes = stream.device<growth::Outcome>(tasks.size());
  memory.results = stream.device<growth::RegionResult>(regions.size());
  memory.kept = stream.device<std::uint32_t>(members);
  growStemsOfBlock<<<static_cast<unsigned>(tasks.size()), kThreads, near_bytes, stream.get()>>>(
      memory);
  checkLaunch("growth of stems");
  GpuGrowth result{};
  result.outcomes = stream.toHost(memory.outcomes, tasks.size());
  result.regions = stream.toHost(memory.results, regions.size());
  result.points = stream.toHost(memory.kept, members);
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
