#include <vector>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "completion/surface_prior_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr int kThreads = 128;  // more than a block of the normal equations has elements
constexpr std::size_t kNearBytes = coarse::nearSize(kThreads) * sizeof(double);
static_assert(kNearBytes <= std::size_t{64} << 10U, "what compute capability 7.5 has fits");

/// Of all pieces. Coefficients and covariances have the size of the largest layout.
struct DeviceMemoryOfPriors {
  const SurfacePriorPiece* pieces;
  const double* places;
  const double* curves;
  const NoiseEffect* effects;
  const std::uint32_t* draws;
  const std::size_t* far_begins;
  double* far;
  SurfacePriorFit* fits;
  double* fitted_curves;
  double* coefficients;
  double* covariances;
};

/// One thread block for each piece.
__global__ void __launch_bounds__(kThreads) fitPriors(DeviceMemoryOfPriors memory) {
  extern __shared__ double near[];
  const unsigned i = blockIdx.x;
  const SurfacePriorPiece& piece = memory.pieces[i];
  const std::size_t curve = 3U * static_cast<std::size_t>(piece.first_node);
  constexpr std::size_t kMost = coarse::kMostCoefficients;
  SurfacePriorTask task = piece.task;
  task.points = memory.places + 3U * static_cast<std::size_t>(piece.first_point);
  task.curve = memory.curves + curve;
  task.effects = memory.effects;
  task.draws = memory.draws;
  const SurfacePriorFit fit =
      SurfacePriorFitter<GpuTeam>(
          GpuTeam(), task, memory.fitted_curves + curve, memory.coefficients + kMost * i,
          memory.covariances + kMost * kMost * i, near, memory.far + memory.far_begins[i])
          .run();
  if (threadIdx.x == 0U) memory.fits[i] = fit;
}

}  // namespace

GpuSurfacePriors surfacePriorsOnGpu(GpuStream& stream, const SurfacePriorPieces& stems) {
  std::size_t far_size = 0U;
  std::vector<std::size_t> far_begins;
  for (std::size_t i = 0; i < stems.count; ++i) {
    far_begins.push_back(far_size);
    const SurfacePriorTask& task = stems.pieces[i].task;
    far_size += coarse::farSize(task.count, task.nodes, kThreads);
  }
  constexpr std::size_t kMost = coarse::kMostCoefficients;
  constexpr std::size_t kEffects = NoiseEffect::kSteps + 1U;
  DeviceMemoryOfPriors memory{};
  memory.pieces = stream.toDevice(stems.pieces, stems.count);
  memory.places = stream.toDevice(stems.places, 3U * stems.points);
  memory.curves = stream.toDevice(stems.curves, 3U * stems.nodes);
  memory.effects = stream.toDevice(stems.effects, kEffects);
  memory.draws = stream.toDevice(stems.draws, static_cast<std::size_t>(coarse::kDraws));
  memory.far_begins = stream.toDevice(far_begins.data(), far_begins.size());
  memory.far = stream.device<double>(far_size);
  memory.fits = stream.device<SurfacePriorFit>(stems.count);
  memory.fitted_curves = stream.device<double>(3U * stems.nodes);
  memory.coefficients = stream.device<double>(kMost * stems.count);
  memory.covariances = stream.device<double>(kMost * kMost * stems.count);
  allowSharedMemory(fitPriors);
  fitPriors<<<static_cast<unsigned>(stems.count), kThreads, kNearBytes, stream.get()>>>(memory);
  checkLaunch("coarse models of stems");
  const GpuSurfacePriors result{stream.toHost(memory.fits, stems.count),
                                stream.toHost(memory.fitted_curves, 3U * stems.nodes),
                                stream.toHost(memory.coefficients, kMost * stems.count),
                                stream.toHost(memory.covariances, kMost * kMost * stems.count)};
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
