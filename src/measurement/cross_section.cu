#include <algorithm>
#include <vector>

#include "common/gpu_stream.hpp"
#include "common/gpu_team.cuh"
#include "measurement/cross_section_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kStartThreads = 64U;
constexpr unsigned kLeastThreads = 32U;
constexpr unsigned kMostThreads = 256U;  // 64 points at once
/// What every thread block may have without asking for more.
constexpr std::size_t kUsualSharedBytes = std::size_t{48} << 10U;

/// Shared memory of startPieces() behind the records of the threads.
struct StartMemory {
  start::Sums sums;
  double matrix[kCrossSectionSize * kCrossSectionSize];
  double vector[kCrossSectionSize];
  double solution[kCrossSectionSize];
};
constexpr std::size_t startBytes(unsigned threads) {
  return threads * sizeof(start::Record) + sizeof(StartMemory);
}
static_assert(startBytes(kStartThreads) <= kUsualSharedBytes, "it fits in");

__device__ CrossSectionPoints pointsOf(const CrossSectionPiece& piece, const double* places) {
  return {places + 3U * static_cast<std::size_t>(piece.first_point), piece.count};
}

/// One thread block for each piece.
__global__ void startPieces(const CrossSectionPiece* pieces, const double* places,
                            CrossSectionStart* starts) {
  extern __shared__ double shared[];
  auto* records = reinterpret_cast<start::Record*>(shared);
  auto* memory = reinterpret_cast<StartMemory*>(records + blockDim.x);
  const CrossSectionPiece& piece = pieces[blockIdx.x];
  const CrossSectionStart found =
      startCrossSection(GpuTeam(), pointsOf(piece, places), piece.task,
                        {records, &memory->sums, memory->matrix, memory->vector, memory->solution});
  if (threadIdx.x == 0U) starts[blockIdx.x] = found;
}

/// Where a piece's memory lies; in numbers from the beginning of the whole.
struct MixtureMemory {
  int bins;
  bool is_shared;         // what the team's members share is in shared memory
  std::size_t shared;     // else where it is
  std::size_t of_points;  // memory of the groups' points
};

/// One thread block for each piece.
__global__ void __launch_bounds__(kMostThreads)
    fitPieces(const CrossSectionPiece* pieces, const double* places,
              const CrossSectionStart* starts, const MixtureMemory* layout, double* memory,
              SurfaceMixtureFit* fits) {
  extern __shared__ double shared[];
  const CrossSectionPiece& piece = pieces[blockIdx.x];
  const MixtureMemory& own = layout[blockIdx.x];
  fitSurfaceMixture(GpuTeam(), pointsOf(piece, places), piece.task, starts[blockIdx.x], own.bins,
                    own.is_shared ? shared : memory + own.shared, memory + own.of_points,
                    fits[blockIdx.x]);
}

/// A group of lanes for every point that a usual piece has.
unsigned threadsFor(std::size_t points, std::uint32_t pieces) {
  unsigned threads = kLeastThreads;
  while (threads < kMostThreads && threads / kLanes * static_cast<std::size_t>(pieces) < points) {
    threads *= 2U;
  }
  return threads;
}

}  // namespace

GpuCrossSections crossSectionsOnGpu(GpuStream& stream, const double* places, std::size_t points,
                                    const CrossSectionPiece* pieces, std::uint32_t count) {
  const unsigned threads = threadsFor(points, count);
  const double* device_places = stream.toDevice(places, 3U * points);
  const CrossSectionPiece* device_pieces = stream.toDevice(pieces, count);
  auto* device_starts = stream.device<CrossSectionStart>(count);
  startPieces<<<count, kStartThreads, startBytes(kStartThreads), stream.get()>>>(
      device_pieces, device_places, device_starts);
  checkLaunch("starts of cross-sections");
  const CrossSectionStart* starts = stream.toHost(device_starts, count);
  stream.wait();

  // How many bins a piece has depends on its noise.
  const std::size_t most_shared = allowSharedMemory(fitPieces);
  std::size_t shared_bytes = 0U;
  std::size_t size = 0U;
  std::vector<MixtureMemory> layout;
  layout.reserve(count);
  for (std::uint32_t i = 0U; i < count; ++i) {
    const int bins = mixture::binsOf(starts[i].parameters);
    const std::size_t shared = mixture::sharedScratchSize(bins);
    const bool is_shared = shared * sizeof(double) <= most_shared;
    layout.push_back({bins, is_shared, size, size + (is_shared ? 0U : shared)});
    size = layout.back().of_points + threads / kLanes * mixture::pointScratchSize(bins);
    if (is_shared) shared_bytes = std::max(shared_bytes, shared * sizeof(double));
  }
  const MixtureMemory* device_layout = stream.toDevice(layout.data(), layout.size());
  auto* memory = stream.device<double>(size);
  auto* fits = stream.device<SurfaceMixtureFit>(count);
  checkGpu(cudaMemsetAsync(fits, 0, count * sizeof(SurfaceMixtureFit), stream.get()),
           "clearing of fits");
  fitPieces<<<count, threads, shared_bytes, stream.get()>>>(
      device_pieces, device_places, device_starts, device_layout, memory, fits);
  checkLaunch("fits of cross-sections");
  const GpuCrossSections result{starts, stream.toHost(fits, count)};
  stream.wait();
  return result;
}

}  // namespace field_phenotyping
