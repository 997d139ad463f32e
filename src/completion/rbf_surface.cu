#include <algorithm>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "completion/rbf_surface_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr int kThreads = 128;  // about as many as a region has places to be read

/// Where what belongs to one surface begins.
struct Begin {
  std::size_t center;
  std::size_t place;
  std::size_t matrix;  // in the device's memory, for one that does not fit into shared memory
};

/// Of all surfaces, one after the other.
struct DeviceMemoryOfSurfaces {
  const RbfReading* readings;  // their pointers are not used
  const Begin* begins;
  const Vector3* centers;
  const double* of_centers;  // values of all, then their noise
  std::size_t center_count;
  const Vector3* places;
  double* weights;
  double* coefficients;
  double* matrices;
  int near_matrix;  // values that fit into shared memory
  double* values;   // of the places
};

/// One thread block for each surface.
__global__ void __launch_bounds__(kThreads) readSurfaces(DeviceMemoryOfSurfaces memory) {
  extern __shared__ double near[];
  __shared__ int bands[kThreads];
  const RbfReading& reading = memory.readings[blockIdx.x];
  const Begin& begin = memory.begins[blockIdx.x];
  RbfTask task = reading.task;
  task.centers.points = memory.centers + begin.center;
  task.values = memory.of_centers + begin.center;
  task.noise = memory.of_centers + memory.center_count + begin.center;
  double* weights = memory.weights + begin.center;
  double* coefficients = memory.coefficients + begin.center;
  const GpuTeam team;
  RbfSolver<GpuTeam> solver(team, task, weights, coefficients);
  const int band = solver.prepare(bands);
  const int size = Envelope::valuesOf(static_cast<int>(task.centers.count), band, 0);
  solver.solve(size <= memory.near_matrix ? near : memory.matrices + begin.matrix, band);
  for (std::size_t i = team.rank(); i < reading.place_count; i += team.size()) {
    memory.values[begin.place + i] =
        rbf::valueAt(task, weights, coefficients, memory.places[begin.place + i]);
  }
}

}  // namespace

const double* readSurfacesOnGpu(GpuStream& stream, const std::vector<RbfReading>& readings) {
  // Most systems fit, and two thread blocks share a processor. Compute capability 7.5 has 64 KiB.
  constexpr std::size_t kNearBytes = std::size_t{60} << 10U;
  std::vector<Begin> begins;
  std::vector<Vector3> centers;
  std::vector<double> of_centers;
  std::vector<Vector3> places;
  std::size_t matrices = 0U;
  for (const RbfReading& reading : readings) {
    const RbfTask& task = reading.task;
    begins.push_back({centers.size(), places.size(), matrices});
    centers.insert(centers.end(), task.centers.points, task.centers.points + task.centers.count);
    of_centers.insert(of_centers.end(), task.values, task.values + task.centers.count);
    places.insert(places.end(), reading.places, reading.places + reading.place_count);
    if (reading.most_matrix * sizeof(double) > kNearBytes) matrices += reading.most_matrix;
  }
  for (const RbfReading& reading : readings) {
    of_centers.insert(of_centers.end(), reading.task.noise,
                      reading.task.noise + reading.task.centers.count);
  }
  DeviceMemoryOfSurfaces memory{};
  memory.readings = stream.toDevice(readings.data(), readings.size());
  memory.begins = stream.toDevice(begins.data(), begins.size());
  memory.centers = stream.toDevice(centers.data(), centers.size());
  memory.of_centers = stream.toDevice(of_centers.data(), of_centers.size());
  memory.center_count = centers.size();
  memory.places = stream.toDevice(places.data(), places.size());
  memory.weights = stream.device<double>(centers.size());
  memory.coefficients = stream.device<double>(centers.size());
  memory.matrices = stream.device<double>(matrices);
  memory.near_matrix = static_cast<int>(kNearBytes / sizeof(double));
  memory.values = stream.device<double>(places.size());
  allowSharedMemory(readSurfaces);
  readSurfaces<<<static_cast<unsigned>(readings.size()), kThreads, kNearBytes, stream.get()>>>(
      memory);
  checkLaunch("surfaces of stems");
  const double* values = stream.toHost(memory.values, places.size());
  stream.wait();
  return values;
}

}  // namespace field_phenotyping
