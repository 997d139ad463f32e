#include <algorithm>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "completion/gap_sampling_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kThreads = 128U;  // more than a stretch has rows of cells
/// Scratch memory of most tasks is smaller; what every thread block may have without asking for
/// more.
constexpr std::size_t kNearBytes = std::size_t{48} << 10U;

/// Where what belongs to one task begins.
struct Begin {
  std::size_t place;
  std::size_t row;
  std::size_t column;
  std::size_t gap;
  std::size_t cell;
  std::size_t scratch;  // in the device's memory, for what does not fit into shared memory [bytes]
};

/// Of all tasks, one after the other.
struct DeviceMemoryOfGaps {
  const GapTask* tasks;  // their pointers are not used
  const Begin* begins;
  const SurfacePosition* places;
  const double* radii;
  const unsigned char* fills;
  const GapOutline* outlines;
  Gap* gaps;
  int* cells;
  GapTotals* totals;
  char* scratch;
};

/// Bytes of scratch memory, for one member of the team for each thread.
FIELD_PHENOTYPING_HD std::size_t scratchBytes(const GapTask& task) {
  const auto cells = static_cast<std::size_t>(task.grid.cells());
  constexpr std::size_t kWhole = alignof(int);
  return kThreads * sizeof(GapRows) + static_cast<std::size_t>(task.mostRuns()) * sizeof(GapRun) +
         (static_cast<std::size_t>(task.grid.rows) + 1U) * sizeof(int) +
         (cells + kWhole - 1U) / kWhole * kWhole;
}

/// One thread block for each task.
__global__ void __launch_bounds__(kThreads) findGapsOfStretches(DeviceMemoryOfGaps memory) {
  extern __shared__ int near[];
  GapTask task = memory.tasks[blockIdx.x];
  const Begin& begin = memory.begins[blockIdx.x];
  task.places = memory.places + begin.place;
  task.radii = memory.radii + begin.row;
  task.fills = memory.fills + begin.row;
  task.outlines = memory.outlines + begin.column;
  // All but the last are made of whole numbers.
  auto* rows = reinterpret_cast<GapRows*>(
      scratchBytes(task) <= kNearBytes ? near
                                       : reinterpret_cast<int*>(memory.scratch + begin.scratch));
  auto* runs = reinterpret_cast<GapRun*>(rows + kThreads);
  auto* run_begins = reinterpret_cast<int*>(runs + task.mostRuns());
  auto* missing = reinterpret_cast<unsigned char*>(run_begins + task.grid.rows + 1);
  GapFinder<GpuTeam>(GpuTeam(), task, {run_begins, runs, rows, missing})
      .find(memory.gaps + begin.gap, memory.cells + begin.cell, memory.totals + blockIdx.x);
}

/// One thread block for each task. @param first_samples of each task
__global__ void __launch_bounds__(kThreads)
    sampleGapsOfStretches(DeviceMemoryOfGaps memory, const std::size_t* first_samples,
                          SurfacePosition* samples) {
  const Begin& begin = memory.begins[blockIdx.x];
  spreadOverGaps(GpuTeam(), memory.tasks[blockIdx.x].grid, memory.gaps + begin.gap,
                 memory.cells + begin.cell, memory.totals[blockIdx.x].samples,
                 samples + first_samples[blockIdx.x]);
}

}  // namespace

GpuGapSamples gapSamplesOnGpu(GpuStream& stream, const std::vector<GapTask>& tasks) {
  std::vector<Begin> begins;
  std::vector<SurfacePosition> places;
  std::vector<double> radii;
  std::vector<unsigned char> fills;
  std::vector<GapOutline> outlines;
  std::size_t gaps = 0U;
  std::size_t cells = 0U;
  std::size_t far_bytes = 0U;
  std::size_t near_bytes = 0U;
  for (const GapTask& task : tasks) {
    begins.push_back({places.size(), radii.size(), outlines.size(), gaps, cells, far_bytes});
    places.insert(places.end(), task.places, task.places + task.count);
    radii.insert(radii.end(), task.radii, task.radii + task.grid.rows);
    fills.insert(fills.end(), task.fills, task.fills + task.grid.rows);
    outlines.insert(outlines.end(), task.outlines, task.outlines + task.grid.columns);
    gaps += static_cast<std::size_t>(task.mostRuns());
    cells += static_cast<std::size_t>(task.grid.cells());
    const std::size_t bytes = scratchBytes(task);
    if (bytes <= kNearBytes) {
      near_bytes = std::max(near_bytes, bytes);
    } else {
      far_bytes += bytes;
    }
  }
  DeviceMemoryOfGaps memory{};
  memory.tasks = stream.toDevice(tasks.data(), tasks.size());
  memory.begins = stream.toDevice(begins.data(), begins.size());
  memory.places = stream.toDevice(places.data(), places.size());
  memory.radii = stream.toDevice(radii.data(), radii.size());
  memory.fills = stream.toDevice(fills.data(), fills.size());
  memory.outlines = stream.toDevice(outlines.data(), outlines.size());
  memory.gaps = stream.device<Gap>(gaps);
  memory.cells = stream.device<int>(cells);
  memory.totals = stream.device<GapTotals>(tasks.size());
  memory.scratch = stream.device<char>(far_bytes);
  const auto blocks = static_cast<unsigned>(tasks.size());
  findGapsOfStretches<<<blocks, kThreads, near_bytes, stream.get()>>>(memory);
  checkLaunch("gaps of stems");
  GpuGapSamples result{};
  result.totals = stream.toHost(memory.totals, tasks.size());
  stream.wait();

  // How many points fill them is known now.
  std::vector<std::size_t> first_samples;
  std::size_t samples = 0U;
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    first_samples.push_back(samples);
    samples += static_cast<std::size_t>(result.totals[k].samples);
  }
  const std::size_t* device_begins = stream.toDevice(first_samples.data(), first_samples.size());
  auto* device_samples = stream.device<SurfacePosition>(samples);
  sampleGapsOfStretches<<<blocks, kThreads, 0U, stream.get()>>>(memory, device_begins,
                                                                device_samples);
  checkLaunch("points in gaps of stems");
  result.places = stream.toHost(device_samples, samples);
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
